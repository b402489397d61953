/* A module for libvips that loads and saves .ssplat: `vips copy photo.jpg photo.ssplat[Q=60,effort=3]`, vipsthumbnail, and every
 * language that uses libvips. capi/README.md says how to build and install it.
 *
 *   Q         SSIMULACRA2 score, 0 to 100; 70 is the default
 *   lossless  stores the samples
 *   effort    1 to 9; 5 is the default
 *   strip     leaves out the ICC profile and the EXIF block */
#include <gmodule.h>
#include <string.h>
#include <vips/vips.h>

#include "ssplat.h"

static const char *suffixes[] = {".ssplat", NULL};

/* Loading. One class holds what the loaders of files and of memory share. */

typedef struct {
    VipsForeignLoad parent;
    ssplat_decoder *decoder;
} Load;

typedef VipsForeignLoadClass LoadClass;

typedef struct {
    Load load;
    char *filename;
} LoadFile;

typedef LoadClass LoadFileClass;

typedef struct {
    Load load;
    VipsArea *buffer;
} LoadBuffer;

typedef LoadClass LoadBufferClass;

G_DEFINE_ABSTRACT_TYPE(Load, ssplat_load, VIPS_TYPE_FOREIGN_LOAD)
G_DEFINE_TYPE(LoadFile, ssplat_load_file, ssplat_load_get_type())
G_DEFINE_TYPE(LoadBuffer, ssplat_load_buffer, ssplat_load_get_type())

/* Passes the error of the decoder on to libvips. Returns -1 if there is one. */
static int check_load(Load *load, ssplat_status status)
{
    char message[512];
    if (status == SSPLAT_STATUS_OK)
        return 0;
    ssplat_decoder_message(load->decoder, message, sizeof message);
    vips_error("ssplatload", "%s", message);
    return -1;
}

static int is_kept(void *image, float done)
{
    (void)done;
    return vips_image_iskilled(image);
}

/* Attaches a block of metadata, after `prefix`. */
static int read_metadata(Load *load, VipsImage *out, int which, const char *name, const char *prefix, size_t prefix_length)
{
    size_t length = 0;
    if (check_load(load, ssplat_decoder_metadata(load->decoder, which, NULL, 0, &length)))
        return -1;
    if (length == 0)
        return 0;
    char *bytes = g_malloc(prefix_length + length);
    if (prefix_length)
        memcpy(bytes, prefix, prefix_length);
    if (check_load(load, ssplat_decoder_metadata(load->decoder, which, bytes + prefix_length, length, &length))) {
        g_free(bytes);
        return -1;
    }
    vips_image_set_blob(out, name, (VipsCallbackFn)vips_area_free_cb, bytes, prefix_length + length);
    return 0;
}

static void set_fields(const ssplat_info *info, VipsImage *out)
{
    int wide = info->bits == 16, color = info->channels > 2;
    VipsInterpretation interpretation = color ? wide ? VIPS_INTERPRETATION_RGB16 : VIPS_INTERPRETATION_sRGB
        : wide ? VIPS_INTERPRETATION_GREY16 : VIPS_INTERPRETATION_B_W;
    vips_image_init_fields(out, (int)info->width, (int)info->height, (int)info->channels, wide ? VIPS_FORMAT_USHORT : VIPS_FORMAT_UCHAR,
        VIPS_CODING_NONE, interpretation, 1, 1);
}

static int load_header(VipsForeignLoad *foreign)
{
    Load *load = (Load *)foreign;
    ssplat_info info = {0};
    if (check_load(load, ssplat_decoder_info(load->decoder, &info)))
        return -1;
    set_fields(&info, foreign->out);
    if (vips_image_pipelinev(foreign->out, VIPS_DEMAND_STYLE_ANY, NULL))
        return -1;
    if (info.orientation != 1)
        vips_image_set_int(foreign->out, VIPS_META_ORIENTATION, (int)info.orientation);
    return read_metadata(load, foreign->out, SSPLAT_METADATA_ICC, VIPS_META_ICC_NAME, NULL, 0)
        || read_metadata(load, foreign->out, SSPLAT_METADATA_EXIF, VIPS_META_EXIF_NAME, "Exif\0", 6) ? -1 : 0;
}

static int load_pixels(VipsForeignLoad *foreign)
{
    static const int formats[2][4] = {
        {SSPLAT_FORMAT_GREY8, SSPLAT_FORMAT_GREY_ALPHA8, SSPLAT_FORMAT_RGB8, SSPLAT_FORMAT_RGBA8},
        {SSPLAT_FORMAT_GREY16, SSPLAT_FORMAT_GREY_ALPHA16, SSPLAT_FORMAT_RGB16, SSPLAT_FORMAT_RGBA16},
    };
    Load *load = (Load *)foreign;
    ssplat_info info = {0};
    VipsImage *memory = vips_image_new_memory();
    int result = check_load(load, ssplat_decoder_info(load->decoder, &info));
    if (!result) {
        set_fields(&info, memory);
        result = vips_image_write_prepare(memory);
    }
    if (!result) {
        ssplat_buffer buffer = {
            .data = VIPS_IMAGE_ADDR(memory, 0, 0), .size = VIPS_IMAGE_SIZEOF_IMAGE(memory), .format = formats[info.bits == 16][info.channels - 1]};
        ssplat_decoder_set_partial(load->decoder, foreign->fail_on < VIPS_FAIL_ON_TRUNCATED);
        ssplat_decoder_set_callback(load->decoder, is_kept, foreign->out);
        ssplat_missing missing = {0};
        result = check_load(load, ssplat_decoder_decode(load->decoder, NULL, &buffer));
        if (!result && ssplat_decoder_missing(load->decoder, &missing) == SSPLAT_STATUS_OK && missing.damaged)
            g_warning("ssplatload: the file is damaged or cut off; parts of the picture may be missing");
    }
    if (!result)
        result = vips_image_write(memory, foreign->real);
    g_object_unref(memory);
    return result;
}

static int open_file(VipsObject *object)
{
    LoadFile *file = (LoadFile *)object;
    if (file->filename && check_load(&file->load, ssplat_decoder_open_file(file->load.decoder, file->filename)))
        return -1;
    return VIPS_OBJECT_CLASS(ssplat_load_file_parent_class)->build(object);
}

static int open_buffer(VipsObject *object)
{
    LoadBuffer *from = (LoadBuffer *)object;
    if (from->buffer && check_load(&from->load, ssplat_decoder_open_memory(from->load.decoder, from->buffer->data, from->buffer->length)))
        return -1;
    return VIPS_OBJECT_CLASS(ssplat_load_buffer_parent_class)->build(object);
}

static gboolean is_ssplat(const void *data, size_t length)
{
    return length >= 4 && !memcmp(data, "\x89SSP", 4);
}

static gboolean is_ssplat_file(const char *filename)
{
    unsigned char start[4];
    return vips__get_bytes(filename, start, sizeof start) == sizeof start && is_ssplat(start, sizeof start);
}

static VipsForeignFlags load_flags(VipsForeignLoad *foreign)
{
    (void)foreign;
    return 0;
}

static void load_dispose(GObject *object)
{
    ssplat_decoder_free(&((Load *)object)->decoder);
    G_OBJECT_CLASS(ssplat_load_parent_class)->dispose(object);
}

static void ssplat_load_class_init(LoadClass *class)
{
    G_OBJECT_CLASS(class)->dispose = load_dispose;
    VIPS_OBJECT_CLASS(class)->nickname = "ssplatload_base";
    VIPS_OBJECT_CLASS(class)->description = "load ssplat";
    class->get_flags = load_flags;
    class->header = load_header;
    class->load = load_pixels;
}

static void ssplat_load_init(Load *load)
{
    load->decoder = ssplat_decoder_new();
}

static void ssplat_load_file_class_init(LoadFileClass *class)
{
    G_OBJECT_CLASS(class)->set_property = vips_object_set_property;
    G_OBJECT_CLASS(class)->get_property = vips_object_get_property;
    VIPS_OBJECT_CLASS(class)->nickname = "ssplatload";
    VIPS_OBJECT_CLASS(class)->description = "load ssplat from file";
    VIPS_OBJECT_CLASS(class)->build = open_file;
    ((VipsForeignClass *)class)->suffs = suffixes;
    class->is_a = is_ssplat_file;
    VIPS_ARG_STRING(class, "filename", 1, "Filename", "Filename to load from", VIPS_ARGUMENT_REQUIRED_INPUT, G_STRUCT_OFFSET(LoadFile, filename), NULL);
}

static void ssplat_load_file_init(LoadFile *file)
{
    (void)file;
}

static void ssplat_load_buffer_class_init(LoadBufferClass *class)
{
    G_OBJECT_CLASS(class)->set_property = vips_object_set_property;
    G_OBJECT_CLASS(class)->get_property = vips_object_get_property;
    VIPS_OBJECT_CLASS(class)->nickname = "ssplatload_buffer";
    VIPS_OBJECT_CLASS(class)->description = "load ssplat from buffer";
    VIPS_OBJECT_CLASS(class)->build = open_buffer;
    class->is_a_buffer = is_ssplat;
    VIPS_ARG_BOXED(class, "buffer", 1, "Buffer", "Buffer to load from", VIPS_ARGUMENT_REQUIRED_INPUT, G_STRUCT_OFFSET(LoadBuffer, buffer), VIPS_TYPE_BLOB);
}

static void ssplat_load_buffer_init(LoadBuffer *from)
{
    (void)from;
}

/* Saving. */

typedef struct {
    VipsForeignSave parent;
    VipsTarget *target;
    double quality;
    gboolean lossless;
    int effort;
} Save;

typedef VipsForeignSaveClass SaveClass;

typedef struct {
    Save save;
    char *filename;
} SaveFile;

typedef SaveClass SaveFileClass;

typedef struct {
    Save save;
    VipsArea *buffer;
} SaveBuffer;

typedef SaveClass SaveBufferClass;

G_DEFINE_ABSTRACT_TYPE(Save, ssplat_save, VIPS_TYPE_FOREIGN_SAVE)
G_DEFINE_TYPE(SaveFile, ssplat_save_file, ssplat_save_get_type())
G_DEFINE_TYPE(SaveBuffer, ssplat_save_buffer, ssplat_save_get_type())

static int write_bytes(void *target, const void *data, size_t size)
{
    return vips_target_write(target, data, size);
}

static int is_wanted(void *image, const char *stage, float done)
{
    (void)stage, (void)done;
    return vips_image_iskilled(image);
}

static ssplat_status write_metadata(ssplat_encoder *encoder, VipsImage *image, int which, const char *name, size_t skipped)
{
    const void *data;
    size_t length;
    if (!vips_image_get_typeof(image, name) || vips_image_get_blob(image, name, &data, &length) || length <= skipped)
        return SSPLAT_STATUS_OK;
    return ssplat_encoder_set_metadata(encoder, which, (const char *)data + skipped, length - skipped);
}

static int keeps_metadata(const VipsForeignSave *foreign)
{
#if VIPS_MAJOR_VERSION > 8 || VIPS_MINOR_VERSION >= 15
    return foreign->keep != VIPS_FOREIGN_KEEP_NONE;
#else
    return !foreign->strip;
#endif
}

static int save(VipsObject *object)
{
    static const int formats[2][4] = {
        {SSPLAT_FORMAT_GREY8, SSPLAT_FORMAT_GREY_ALPHA8, SSPLAT_FORMAT_RGB8, SSPLAT_FORMAT_RGBA8},
        {SSPLAT_FORMAT_GREY16, SSPLAT_FORMAT_GREY_ALPHA16, SSPLAT_FORMAT_RGB16, SSPLAT_FORMAT_RGBA16},
    };
    Save *options = (Save *)object;
    VipsForeignSave *foreign = (VipsForeignSave *)object;
    if (VIPS_OBJECT_CLASS(ssplat_save_parent_class)->build(object))
        return -1;
    VipsImage *memory = vips_image_copy_memory(foreign->ready);
    if (!memory)
        return -1;
    ssplat_pixels pixels = {
        .data = VIPS_IMAGE_ADDR(memory, 0, 0),
        .size = VIPS_IMAGE_SIZEOF_IMAGE(memory),
        .width = (uint32_t)memory->Xsize,
        .height = (uint32_t)memory->Ysize,
        .format = formats[memory->BandFmt == VIPS_FORMAT_USHORT][memory->Bands - 1],
    };
    ssplat_encoder *encoder = ssplat_encoder_new();
    ssplat_status status = ssplat_encoder_set_target(encoder, options->lossless ? SSPLAT_TARGET_LOSSLESS : SSPLAT_TARGET_QUALITY, options->quality);
    if (status == SSPLAT_STATUS_OK)
        status = ssplat_encoder_set_option(encoder, SSPLAT_OPTION_EFFORT, options->effort);
    if (status == SSPLAT_STATUS_OK && keeps_metadata(foreign))
        status = write_metadata(encoder, memory, SSPLAT_METADATA_ICC, VIPS_META_ICC_NAME, 0);
    /* libvips keeps the bytes "Exif\0\0" in front of the block. */
    if (status == SSPLAT_STATUS_OK && keeps_metadata(foreign))
        status = write_metadata(encoder, memory, SSPLAT_METADATA_EXIF, VIPS_META_EXIF_NAME, 6);
    if (status == SSPLAT_STATUS_OK)
        status = ssplat_encoder_set_callback(encoder, is_wanted, foreign->ready);
    if (status == SSPLAT_STATUS_OK)
        status = ssplat_encoder_encode(encoder, &pixels, write_bytes, options->target);
    if (status != SSPLAT_STATUS_OK) {
        char message[512];
        ssplat_encoder_message(encoder, message, sizeof message);
        vips_error("ssplatsave", "%s", message);
    }
    ssplat_encoder_free(&encoder);
    g_object_unref(memory);
    return status == SSPLAT_STATUS_OK ? 0 : -1;
}

static void finish_target(VipsTarget *target)
{
#if VIPS_MAJOR_VERSION > 8 || VIPS_MINOR_VERSION >= 13
    vips_target_end(target);
#else
    vips_target_finish(target);
#endif
}

static int save_file(VipsObject *object)
{
    SaveFile *file = (SaveFile *)object;
    if (!file->filename || !(file->save.target = vips_target_new_to_file(file->filename)))
        return -1;
    int result = VIPS_OBJECT_CLASS(ssplat_save_file_parent_class)->build(object);
    finish_target(file->save.target);
    return result;
}

static int save_buffer(VipsObject *object)
{
    SaveBuffer *to = (SaveBuffer *)object;
    VipsBlob *blob;
    if (!(to->save.target = vips_target_new_to_memory()) || VIPS_OBJECT_CLASS(ssplat_save_buffer_parent_class)->build(object))
        return -1;
    finish_target(to->save.target);
    g_object_get(to->save.target, "blob", &blob, NULL);
    g_object_set(to, "buffer", blob, NULL);
    vips_area_unref(VIPS_AREA(blob));
    return 0;
}

static void save_dispose(GObject *object)
{
    VIPS_UNREF(((Save *)object)->target);
    G_OBJECT_CLASS(ssplat_save_parent_class)->dispose(object);
}

static void ssplat_save_class_init(SaveClass *class)
{
    static VipsBandFormat formats[10] = {
        VIPS_FORMAT_UCHAR, VIPS_FORMAT_UCHAR, VIPS_FORMAT_USHORT, VIPS_FORMAT_USHORT, VIPS_FORMAT_USHORT, VIPS_FORMAT_USHORT,
        VIPS_FORMAT_UCHAR, VIPS_FORMAT_UCHAR, VIPS_FORMAT_UCHAR, VIPS_FORMAT_UCHAR};
    G_OBJECT_CLASS(class)->dispose = save_dispose;
    G_OBJECT_CLASS(class)->set_property = vips_object_set_property;
    G_OBJECT_CLASS(class)->get_property = vips_object_get_property;
    VIPS_OBJECT_CLASS(class)->nickname = "ssplatsave_base";
    VIPS_OBJECT_CLASS(class)->description = "save ssplat";
    VIPS_OBJECT_CLASS(class)->build = save;
    ((VipsForeignClass *)class)->suffs = suffixes;
    class->saveable = VIPS_SAVEABLE_RGBA;
    class->format_table = formats;
    VIPS_ARG_DOUBLE(class, "Q", 10, "Q", "Quality: SSIMULACRA2 score", VIPS_ARGUMENT_OPTIONAL_INPUT, G_STRUCT_OFFSET(Save, quality), 0, 100, 70);
    VIPS_ARG_BOOL(class, "lossless", 11, "Lossless", "Store the samples", VIPS_ARGUMENT_OPTIONAL_INPUT, G_STRUCT_OFFSET(Save, lossless), FALSE);
    VIPS_ARG_INT(class, "effort", 12, "Effort", "Amount of work", VIPS_ARGUMENT_OPTIONAL_INPUT, G_STRUCT_OFFSET(Save, effort), 1, 9, 5);
}

static void ssplat_save_init(Save *options)
{
    options->quality = 70;
    options->effort = 5;
}

static void ssplat_save_file_class_init(SaveFileClass *class)
{
    G_OBJECT_CLASS(class)->set_property = vips_object_set_property;
    G_OBJECT_CLASS(class)->get_property = vips_object_get_property;
    VIPS_OBJECT_CLASS(class)->nickname = "ssplatsave";
    VIPS_OBJECT_CLASS(class)->description = "save image to ssplat file";
    VIPS_OBJECT_CLASS(class)->build = save_file;
    VIPS_ARG_STRING(class, "filename", 1, "Filename", "Filename to save to", VIPS_ARGUMENT_REQUIRED_INPUT, G_STRUCT_OFFSET(SaveFile, filename), NULL);
}

static void ssplat_save_file_init(SaveFile *file)
{
    (void)file;
}

static void ssplat_save_buffer_class_init(SaveBufferClass *class)
{
    G_OBJECT_CLASS(class)->set_property = vips_object_set_property;
    G_OBJECT_CLASS(class)->get_property = vips_object_get_property;
    VIPS_OBJECT_CLASS(class)->nickname = "ssplatsave_buffer";
    VIPS_OBJECT_CLASS(class)->description = "save image to ssplat buffer";
    VIPS_OBJECT_CLASS(class)->build = save_buffer;
    VIPS_ARG_BOXED(class, "buffer", 1, "Buffer", "Buffer to save to", VIPS_ARGUMENT_REQUIRED_OUTPUT, G_STRUCT_OFFSET(SaveBuffer, buffer), VIPS_TYPE_BLOB);
}

static void ssplat_save_buffer_init(SaveBuffer *to)
{
    (void)to;
}

G_MODULE_EXPORT const gchar *g_module_check_init(GModule *module)
{
    ssplat_load_file_get_type();
    ssplat_load_buffer_get_type();
    ssplat_save_file_get_type();
    ssplat_save_buffer_get_type();
    g_module_make_resident(module);
    return NULL;
}
