/* Arguments that are wrong in every way C allows: misuse FILE.ssplat, which has at least 64 x 64 pixels. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ssplat.h"

#define CHECK(condition) \
    do { \
        checks++; \
        if (!(condition)) { \
            fprintf(stderr, "line %d: %s\n", __LINE__, #condition); \
            wrong++; \
        } \
    } while (0)

static int checks, wrong;

/* What the callback does, and what it saw. */
struct watcher {
    ssplat_decoder *decoder;
    int calls, stop_at;
    float last;
};

static int watch(void *user, float done)
{
    struct watcher *watcher = user;
    ssplat_info info;
    ssplat_decoder *own = watcher->decoder;
    /* A decoder in use can be neither used nor freed. */
    CHECK(ssplat_decoder_info(watcher->decoder, &info) == SSPLAT_STATUS_BUSY);
    CHECK(ssplat_decoder_free(&own) == SSPLAT_STATUS_BUSY && own == watcher->decoder);
    CHECK(ssplat_decoder_message(watcher->decoder, NULL, 0) > 0);
    CHECK(done >= watcher->last && done <= 1);
    watcher->last = done;
    return ++watcher->calls == watcher->stop_at;
}

static void null_decoders(void)
{
    ssplat_info info;
    ssplat_buffer buffer = {0};
    size_t length;
    uint32_t side;
    ssplat_decoder *none = NULL;
    char text[32];
    CHECK(ssplat_decoder_free(NULL) == SSPLAT_STATUS_OK);
    CHECK(ssplat_decoder_free(&none) == SSPLAT_STATUS_OK);
    CHECK(ssplat_decoder_set_limit(NULL, SSPLAT_LIMIT_ALLOC, 0) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_set_partial(NULL, 1) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_set_callback(NULL, watch, NULL) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_open_memory(NULL, "ssplat", 6) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_open_file(NULL, "/dev/null") == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_open_callback(NULL, NULL, NULL) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_begin(NULL) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_append(NULL, "ssplat", 6) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_missing(NULL, NULL) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_close(NULL) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_info(NULL, &info) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_metadata(NULL, 0, NULL, 0, &length) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_preload(NULL) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_decode(NULL, NULL, &buffer) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_thumbnail(NULL, 8, 8, &buffer, &side, &side) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_message(NULL, text, sizeof text) == strlen("the decoder is NULL") && !strcmp(text, "the decoder is NULL"));
}

static void closed_decoders(ssplat_decoder *decoder)
{
    ssplat_info info;
    ssplat_buffer buffer = {0};
    ssplat_missing missing;
    size_t length;
    uint32_t side;
    char text[100];
    CHECK(ssplat_decoder_info(decoder, &info) == SSPLAT_STATUS_CLOSED);
    CHECK(ssplat_decoder_metadata(decoder, 0, NULL, 0, &length) == SSPLAT_STATUS_CLOSED);
    CHECK(ssplat_decoder_preload(decoder) == SSPLAT_STATUS_CLOSED);
    CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_CLOSED);
    CHECK(ssplat_decoder_thumbnail(decoder, 8, 8, NULL, &side, &side) == SSPLAT_STATUS_CLOSED);
    CHECK(ssplat_decoder_missing(decoder, &missing) == SSPLAT_STATUS_CLOSED);
    CHECK(ssplat_decoder_append(decoder, "x", 1) == SSPLAT_STATUS_CLOSED);
    CHECK(ssplat_decoder_open_callback(decoder, NULL, NULL) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_begin(decoder) == SSPLAT_STATUS_OK);
    CHECK(ssplat_decoder_append(decoder, NULL, 1) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_append(decoder, NULL, 0) == SSPLAT_STATUS_OK);
    CHECK(ssplat_decoder_append(decoder, "text", 4) == SSPLAT_STATUS_FORMAT);
    CHECK(ssplat_decoder_append(decoder, "text", 4) == SSPLAT_STATUS_CLOSED);
    CHECK(ssplat_decoder_close(decoder) == SSPLAT_STATUS_OK);
    CHECK(ssplat_decoder_open_memory(decoder, NULL, 5) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_open_memory(decoder, "x", SIZE_MAX) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_open_memory(decoder, NULL, 0) == SSPLAT_STATUS_TRUNCATED);
    CHECK(ssplat_decoder_message(decoder, text, sizeof text) > 0);
    CHECK(!strcmp(text, "the file is empty (0 bytes), not an ssplat file"));
    CHECK(ssplat_decoder_open_memory(decoder, "not a picture at all, but text", 30) == SSPLAT_STATUS_FORMAT);
    CHECK(ssplat_decoder_open_file(decoder, NULL) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_open_file(decoder, "/nowhere/to/be/found.ssplat") == SSPLAT_STATUS_IO);
    CHECK(ssplat_decoder_open_file(decoder, "/") == SSPLAT_STATUS_IO);
    // Of a file that is none of this format, however long, only the start is read.
    CHECK(ssplat_decoder_open_file(decoder, "/dev/zero") == SSPLAT_STATUS_FORMAT);
    CHECK(ssplat_decoder_info(decoder, &info) == SSPLAT_STATUS_CLOSED);
}

static void messages(ssplat_decoder *decoder)
{
    const char *path = "/nowhere/\xc3\xa4.ssplat";
    char text[256], guard[16];
    size_t length;
    CHECK(ssplat_decoder_open_file(decoder, path) == SSPLAT_STATUS_IO);
    length = ssplat_decoder_message(decoder, text, sizeof text);
    CHECK(length == strlen(text) && strstr(text, path));
    CHECK(ssplat_decoder_message(decoder, NULL, 0) == length && ssplat_decoder_message(decoder, NULL, 99) == length);
    memset(guard, 'x', sizeof guard);
    CHECK(ssplat_decoder_message(decoder, guard, 0) == length && guard[0] == 'x');
    /* A character of two bytes is not cut in two. */
    CHECK(ssplat_decoder_message(decoder, guard, 11) == length && !strcmp(guard, "/nowhere/") && guard[11] == 'x');
    CHECK(ssplat_decoder_message(decoder, guard, 1) == length && guard[0] == 0);
    CHECK(!strcmp(ssplat_status_name(SSPLAT_STATUS_INTERNAL), "internal") && !strcmp(ssplat_status_name(0), "ok"));
    CHECK(!strcmp(ssplat_status_name(SSPLAT_STATUS_TRUNCATED), "truncated"));
    CHECK(!strcmp(ssplat_status_name(14), "unknown") && !strcmp(ssplat_status_name(-1), "unknown"));
    char version[32];
    snprintf(version, sizeof version, "%d.%d.%d", SSPLAT_VERSION_MAJOR, SSPLAT_VERSION_MINOR, SSPLAT_VERSION_PATCH);
    CHECK(!strcmp(ssplat_version(), version));
}

static void buffers(ssplat_decoder *decoder, const ssplat_info *info)
{
    size_t row = (size_t)4 * info->width, size = row * info->height;
    unsigned char *memory = malloc(size), *other = malloc(size);
    ssplat_buffer buffer = {.data = memory, .size = size, .format = SSPLAT_FORMAT_RGBA8};
    uint32_t width, height;
    CHECK(ssplat_decoder_decode(decoder, NULL, NULL) == SSPLAT_STATUS_PARAMETER);
    buffer.data = NULL;
    CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_PARAMETER);
    buffer.data = memory;
    /* Grey formats do not take pictures with colours. */
    const int refused[] = {-1, SSPLAT_FORMAT_GREY8, SSPLAT_FORMAT_GREY_ALPHA16, 9};
    for (int i = 0; i < 4; i++) {
        buffer.format = refused[i];
        CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_PARAMETER);
    }
    buffer.format = SSPLAT_FORMAT_RGBA8;
    buffer.reserved[4] = 1;
    CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_PARAMETER);
    buffer.reserved[4] = 0;
    buffer.format = SSPLAT_FORMAT_RGBA16;
    CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_BUFFER);
    buffer.format = SSPLAT_FORMAT_RGBA8;
    buffer.size = size - 1;
    CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_BUFFER);
    buffer.size = 0;
    CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_BUFFER);
    buffer.size = size;
    buffer.stride = row - 1;
    CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_PARAMETER);
    buffer.stride = row + 1;
    CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_BUFFER);
    buffer.stride = SIZE_MAX;
    CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_LIMIT);
    buffer.stride = 0;
    CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_OK);
    CHECK(ssplat_decoder_message(decoder, NULL, 0) == 0);
    /* What was preloaded draws the same. */
    CHECK(ssplat_decoder_preload(decoder) == SSPLAT_STATUS_OK);
    buffer.data = other;
    CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_OK && !memcmp(memory, other, size));
    CHECK(ssplat_decoder_thumbnail(decoder, 32, 32, NULL, NULL, &height) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_thumbnail(decoder, 32, 32, NULL, &width, NULL) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_thumbnail(decoder, 0, 32, NULL, &width, &height) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_thumbnail(decoder, 32, 32, NULL, &width, &height) == SSPLAT_STATUS_OK);
    CHECK(width <= 32 && height <= 32 && (width == 32 || height == 32));
    buffer.size = (size_t)4 * width * height - 1;
    CHECK(ssplat_decoder_thumbnail(decoder, 32, 32, &buffer, &width, &height) == SSPLAT_STATUS_BUFFER);
    buffer.size++;
    CHECK(ssplat_decoder_thumbnail(decoder, 32, 32, &buffer, &width, &height) == SSPLAT_STATUS_OK);
    free(memory);
    free(other);
}

static void views(ssplat_decoder *decoder, const ssplat_info *info)
{
    size_t size = (size_t)4 * info->width * info->height;
    unsigned char *whole = malloc(size), part[4 * 16 * 8];
    ssplat_buffer buffer = {.data = whole, .size = size, .format = SSPLAT_FORMAT_RGBA8};
    ssplat_buffer small = {.data = part, .size = sizeof part, .format = SSPLAT_FORMAT_RGBA8};
    ssplat_view bad[] = {
        {0, 0, info->width + 1, 1, 0, 0, {0}},
        {UINT32_MAX, 0, 2, 2, 0, 0, {0}},
        {1, 1, UINT32_MAX, UINT32_MAX, 0, 0, {0}},
        {1, 0, 0, 0, 0, 0, {0}},
        {0, 0, 8, 0, 0, 0, {0}},
        {0, 0, 0, 0, 8, 0, {0}},
        {0, 0, 0, 0, 0, 8, {0}},
        {0, 0, 0, 0, UINT32_MAX, 1, {0}},
    };
    ssplat_view inside = {20, 30, 16, 8, 0, 0, {0}}, huge = {0, 0, 0, 0, 1 << 20, 1 << 20, {0}};
    inside.reserved[0] = 1;
    CHECK(ssplat_decoder_decode(decoder, &inside, &buffer) == SSPLAT_STATUS_PARAMETER);
    inside.reserved[0] = 0;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        CHECK(ssplat_decoder_decode(decoder, &bad[i], &buffer) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_decode(decoder, &huge, &buffer) == SSPLAT_STATUS_BUFFER);
    /* A caller that lies about its memory is stopped by the limits before anything is written. */
    buffer.size = SIZE_MAX;
    CHECK(ssplat_decoder_decode(decoder, &huge, &buffer) == SSPLAT_STATUS_LIMIT);
    buffer.size = size;
    CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_OK);
    CHECK(ssplat_decoder_decode(decoder, &inside, &small) == SSPLAT_STATUS_OK);
    for (int y = 0; y < 8; y++)
        CHECK(!memcmp(part + 64 * y, whole + 4 * ((size_t)(30 + y) * info->width + 20), 64));
    free(whole);
}

static void limits_and_callbacks(ssplat_decoder *decoder, const ssplat_info *info, const char *path)
{
    size_t size = (size_t)4 * info->width * info->height;
    ssplat_buffer buffer = {.data = malloc(size), .size = size, .format = SSPLAT_FORMAT_RGBA8};
    struct watcher watcher = {decoder, 0, 0, 0};
    CHECK(ssplat_decoder_set_limit(decoder, -1, 0) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_set_limit(decoder, 8, 0) == SSPLAT_STATUS_PARAMETER && ssplat_limit_default(8) == 0);
    for (int limit = SSPLAT_LIMIT_WIDTH; limit <= SSPLAT_LIMIT_ALLOC; limit++) {
        CHECK(ssplat_decoder_set_limit(decoder, limit, limit == SSPLAT_LIMIT_OVERLAP ? 1 << 30 : 1) == SSPLAT_STATUS_OK);
        ssplat_status status = ssplat_decoder_open_file(decoder, path);
        if (status == SSPLAT_STATUS_OK)
            status = ssplat_decoder_decode(decoder, NULL, &buffer);
        CHECK(status == (limit == SSPLAT_LIMIT_OVERLAP ? SSPLAT_STATUS_OK : SSPLAT_STATUS_LIMIT));
        CHECK(ssplat_decoder_set_limit(decoder, limit, ssplat_limit_default(limit)) == SSPLAT_STATUS_OK);
    }
    CHECK(ssplat_decoder_open_file(decoder, path) == SSPLAT_STATUS_OK);
    CHECK(ssplat_decoder_set_callback(decoder, watch, &watcher) == SSPLAT_STATUS_OK);
    CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_OK && watcher.last == 1 && watcher.calls > 3);
    /* Stopped at every step that there is. */
    for (int steps = watcher.calls, stop = 1; stop <= steps; stop++) {
        watcher = (struct watcher){decoder, 0, stop, 0};
        CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_CANCELLED && watcher.calls == stop);
    }
    CHECK(ssplat_decoder_set_callback(decoder, NULL, NULL) == SSPLAT_STATUS_OK);
    CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_OK);
    free(buffer.data);
}

static void metadata(ssplat_decoder *decoder)
{
    size_t length = 99;
    char byte = 'x';
    CHECK(ssplat_decoder_info(decoder, NULL) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_metadata(decoder, SSPLAT_METADATA_ICC, NULL, 0, NULL) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_metadata(decoder, 4, NULL, 0, &length) == SSPLAT_STATUS_PARAMETER && length == 99);
    CHECK(ssplat_decoder_metadata(decoder, SSPLAT_METADATA_ICC, NULL, 0, &length) == SSPLAT_STATUS_OK && length > 1);
    CHECK(ssplat_decoder_metadata(decoder, SSPLAT_METADATA_ICC, NULL, length, &length) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_decoder_metadata(decoder, SSPLAT_METADATA_ICC, &byte, 1, &length) == SSPLAT_STATUS_BUFFER && byte == 'x');
    char *all = malloc(length);
    CHECK(ssplat_decoder_metadata(decoder, SSPLAT_METADATA_ICC, all, length, &length) == SSPLAT_STATUS_OK);
    CHECK(length > 40 && !memcmp(all + 36, "acsp", 4));
    free(all);
    CHECK(ssplat_decoder_metadata(decoder, SSPLAT_METADATA_EXIF, NULL, 0, &length) == SSPLAT_STATUS_OK && length > 0);
}

int main(int argc, char **argv)
{
    ssplat_info info;
    if (argc != 2)
        return 2;
    ssplat_decoder *decoder = ssplat_decoder_new(), *alias;
    null_decoders();
    closed_decoders(decoder);
    messages(decoder);
    CHECK(ssplat_decoder_open_file(decoder, argv[1]) == SSPLAT_STATUS_OK);
    CHECK(ssplat_decoder_info(decoder, &info) == SSPLAT_STATUS_OK && info.width >= 64 && info.height >= 64);
    CHECK(info.orientation == 6);
    metadata(decoder);
    buffers(decoder, &info);
    views(decoder, &info);
    limits_and_callbacks(decoder, &info, argv[1]);
    alias = decoder;
    CHECK(ssplat_decoder_free(&decoder) == SSPLAT_STATUS_OK && decoder == NULL && alias != NULL);
    CHECK(ssplat_decoder_free(&decoder) == SSPLAT_STATUS_OK);
    printf("%d checks, %d wrong\n", checks, wrong);
    return wrong != 0;
}
