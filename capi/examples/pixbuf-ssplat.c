/* A gdk-pixbuf module that loads .ssplat: image viewers and file managers of GTK 2 and 3 (Eye of GNOME, gThumb, Thunar,
 * Nemo), GTK programs and librsvg read the format with it. See cli/desktop/README.md for how it is installed.
 *
 * The file is read as its bytes arrive, and drawn when the last one has arrived, at the size that the program asks for. */
#define GDK_PIXBUF_ENABLE_BACKEND
#include <gdk-pixbuf/gdk-pixbuf.h>
#include <glib.h>
#include <gmodule.h>
#include <string.h>

#include "ssplat.h"

/* gdk-pixbuf calls these by name. */
G_MODULE_EXPORT void fill_vtable(GdkPixbufModule *module);
G_MODULE_EXPORT void fill_info(GdkPixbufFormat *info);

typedef struct {
    ssplat_decoder *decoder;
    GdkPixbufModuleSizeFunc sized;
    GdkPixbufModulePreparedFunc prepared;
    GdkPixbufModuleUpdatedFunc updated;
    gpointer user;
} context;

/* Sets the error of a call, if it failed. */
static gboolean worked(context *c, ssplat_status status, GError **error)
{
    char message[512] = "";
    if (status == SSPLAT_STATUS_OK)
        return TRUE;
    int code = GDK_PIXBUF_ERROR_FAILED;
    if (status == SSPLAT_STATUS_FORMAT || status == SSPLAT_STATUS_TRUNCATED)
        code = GDK_PIXBUF_ERROR_CORRUPT_IMAGE;
    else if (status == SSPLAT_STATUS_MEMORY || status == SSPLAT_STATUS_LIMIT)
        code = GDK_PIXBUF_ERROR_INSUFFICIENT_MEMORY;
    else if (status == SSPLAT_STATUS_VERSION)
        code = GDK_PIXBUF_ERROR_UNKNOWN_TYPE;
    ssplat_decoder_message(c->decoder, message, sizeof message);
    g_set_error(error, GDK_PIXBUF_ERROR, code, "%s: %s", ssplat_status_name(status), message);
    return FALSE;
}

static void release(context *c)
{
    ssplat_decoder_free(&c->decoder);
    g_free(c);
}

static gpointer begin_load(GdkPixbufModuleSizeFunc sized, GdkPixbufModulePreparedFunc prepared,
                           GdkPixbufModuleUpdatedFunc updated, gpointer user, GError **error)
{
    context *c = g_new0(context, 1);
    *c = (context){ssplat_decoder_new(), sized, prepared, updated, user};
    if (!c->decoder) {
        g_set_error_literal(error, GDK_PIXBUF_ERROR, GDK_PIXBUF_ERROR_INSUFFICIENT_MEMORY, "no memory for a decoder");
        g_free(c);
        return NULL;
    }
    if (!worked(c, ssplat_decoder_begin(c->decoder), error)) {
        release(c);
        return NULL;
    }
    return c;
}

static gboolean load_increment(gpointer data, const guchar *bytes, guint size, GError **error)
{
    context *c = data;
    return worked(c, ssplat_decoder_append(c->decoder, bytes, size), error);
}

/* Hands on what programs need to show the picture: gdk-pixbuf applies neither the orientation nor the profile. */
static gboolean describe(context *c, GdkPixbuf *picture, uint32_t orientation, GError **error)
{
    size_t length = 0;
    char number[12];
    g_snprintf(number, sizeof number, "%u", (unsigned)orientation);
    gdk_pixbuf_set_option(picture, "orientation", number);
    if (!worked(c, ssplat_decoder_metadata(c->decoder, SSPLAT_METADATA_ICC, NULL, 0, &length), error))
        return FALSE;
    if (length == 0)
        return TRUE;
    guchar *profile = g_try_malloc(length);
    if (!profile)
        return TRUE;
    gboolean has = worked(c, ssplat_decoder_metadata(c->decoder, SSPLAT_METADATA_ICC, profile, length, &length), error);
    if (has) {
        gchar *text = g_base64_encode(profile, length);
        gdk_pixbuf_set_option(picture, "icc-profile", text);
        g_free(text);
    }
    g_free(profile);
    return has;
}

/* Draws the picture. The result belongs to the caller; NULL with an error. */
static GdkPixbuf *draw(context *c, GError **error)
{
    ssplat_info info = {0};
    if (!worked(c, ssplat_decoder_info(c->decoder, &info), error))
        return NULL;
    gint width = (gint)info.width, height = (gint)info.height;
    if (c->sized)
        c->sized(&width, &height, c->user);
    /* Programs that only ask for the size end here. */
    if (width <= 0 || height <= 0) {
        g_set_error_literal(error, GDK_PIXBUF_ERROR, GDK_PIXBUF_ERROR_FAILED, "a size of 0 pixels");
        return NULL;
    }
    gboolean has_alpha = info.channels == 2 || info.channels == 4;
    GdkPixbuf *picture = gdk_pixbuf_new(GDK_COLORSPACE_RGB, has_alpha, 8, width, height);
    if (!picture) {
        g_set_error(error, GDK_PIXBUF_ERROR, GDK_PIXBUF_ERROR_INSUFFICIENT_MEMORY, "no memory for %d x %d pixels", width, height);
        return NULL;
    }
    ssplat_view view = {.out_width = (uint32_t)width, .out_height = (uint32_t)height};
    ssplat_buffer buffer = {
        .data = gdk_pixbuf_get_pixels(picture),
        .size = gdk_pixbuf_get_byte_length(picture),
        .stride = (size_t)gdk_pixbuf_get_rowstride(picture),
        .format = has_alpha ? SSPLAT_FORMAT_RGBA8 : SSPLAT_FORMAT_RGB8,
    };
    if (!worked(c, ssplat_decoder_decode(c->decoder, &view, &buffer), error)
        || !describe(c, picture, info.orientation, error)) {
        g_object_unref(picture);
        return NULL;
    }
    return picture;
}

static gboolean stop_load(gpointer data, GError **error)
{
    context *c = data;
    GdkPixbuf *picture = draw(c, error);
    if (picture) {
        if (c->prepared)
            c->prepared(picture, NULL, c->user);
        if (c->updated)
            c->updated(picture, 0, 0, gdk_pixbuf_get_width(picture), gdk_pixbuf_get_height(picture), c->user);
        g_object_unref(picture);
    }
    release(c);
    return picture != NULL;
}

void fill_vtable(GdkPixbufModule *module)
{
    module->begin_load = begin_load;
    module->load_increment = load_increment;
    module->stop_load = stop_load;
}

void fill_info(GdkPixbufFormat *info)
{
    static const GdkPixbufModulePattern signature[] = {{"\x89SSP", NULL, 100}, {NULL, NULL, 0}};
    static const gchar *types[] = {"image/x-ssplat", NULL}, *extensions[] = {"ssplat", NULL};
    info->name = "ssplat";
    info->signature = (GdkPixbufModulePattern *)signature;
    info->description = "ssplat image";
    info->mime_types = (gchar **)types;
    info->extensions = (gchar **)extensions;
    info->flags = GDK_PIXBUF_FORMAT_THREADSAFE;
    info->license = "MIT OR Apache-2.0";
}
