/* The encoder, the formats of pixels, read callbacks and bytes that arrive: encode FOLDER, with the vectors. */
#include <math.h>
#include <stdint.h>

#include "files.h"
#include "ssplat.h"

#define CHECK(condition) \
    do { \
        checks++; \
        if (!(condition)) { \
            fprintf(stderr, "line %d: %s\n", __LINE__, #condition); \
            wrong++; \
        } \
    } while (0)

enum { WIDTH = 21, HEIGHT = 10 };

static int checks, wrong;

/* A file in memory, which a callback fills and another one reads in steps. */
struct file {
    unsigned char bytes[1 << 16];
    size_t length, at, step;
};

static int append(void *user, const void *data, size_t size)
{
    struct file *file = user;
    if (size > sizeof file->bytes - file->length)
        return 1;
    memcpy(file->bytes + file->length, data, size);
    file->length += size;
    return 0;
}

static int full(void *user, const void *data, size_t size)
{
    (void)user, (void)data, (void)size;
    return 28;
}

static int64_t next(void *user, void *buffer, size_t capacity)
{
    struct file *file = user;
    size_t count = file->length - file->at;
    count = count < capacity ? count : capacity;
    count = count < file->step ? count : file->step;
    memcpy(buffer, file->bytes + file->at, count);
    file->at += count;
    return (int64_t)count;
}

static int64_t broken(void *user, void *buffer, size_t capacity)
{
    (void)buffer;
    return *(int *)user ? -1 : (int64_t)capacity + 1;
}

struct watcher {
    ssplat_encoder *encoder;
    int calls, stop_at;
};

static int watch(void *user, const char *stage, float done)
{
    struct watcher *watcher = user;
    ssplat_encoder *own = watcher->encoder;
    CHECK(ssplat_encoder_set_option(own, SSPLAT_OPTION_EFFORT, 1) == SSPLAT_STATUS_BUSY);
    CHECK(ssplat_encoder_free(&own) == SSPLAT_STATUS_BUSY && own == watcher->encoder);
    CHECK(strlen(stage) > 0 && done >= 0 && done <= 1);
    return ++watcher->calls == watcher->stop_at;
}

static size_t bytes_of(int format)
{
    const size_t bytes[] = {4, 8, 3, 6, 1, 2, 2, 4, 4};
    return bytes[format];
}

/* Pixels of every kind in a block of exactly as many bytes as they need; rows are `padding` bytes apart. */
static ssplat_pixels picture(int format, size_t padding)
{
    size_t row = WIDTH * bytes_of(format), stride = row + padding, size = stride * (HEIGHT - 1) + row;
    unsigned char *data = malloc(size);
    for (size_t y = 0; y < HEIGHT; y++)
        for (size_t x = 0; x < row && y * stride + x < size; x++)
            data[y * stride + x] = (unsigned char)(x * x + 7 * y * y);
    /* Premultiplied colours are no larger than alpha, and come back if alpha tells them apart: in opaque pixels all do. */
    for (size_t i = 0; format == SSPLAT_FORMAT_BGRA8_PREMULTIPLIED && i < HEIGHT * WIDTH; i++) {
        unsigned char *pixel = data + i / WIDTH * stride + i % WIDTH * 4;
        for (int k = 0; k < 3; k++)
            pixel[k] = pixel[3] ? pixel[k] % pixel[3] : 0;
    }
    /* Colours under alpha 0 do not come back, so that there are none. */
    for (size_t i = 0; format <= SSPLAT_FORMAT_RGBA16 && i < HEIGHT * WIDTH; i++)
        data[i / WIDTH * stride + i % WIDTH * bytes_of(format) + bytes_of(format) - 1] |= 1;
    for (size_t i = 0; (format == SSPLAT_FORMAT_GREY_ALPHA8 || format == SSPLAT_FORMAT_GREY_ALPHA16) && i < HEIGHT * WIDTH; i++)
        data[i / WIDTH * stride + i % WIDTH * bytes_of(format) + bytes_of(format) - 1] |= 1;
    return (ssplat_pixels){.data = data, .size = size, .stride = padding ? stride : 0, .width = WIDTH, .height = HEIGHT, .format = format};
}

static void every_format_comes_back_without_loss(ssplat_encoder *encoder, ssplat_decoder *decoder)
{
    CHECK(ssplat_encoder_set_target(encoder, SSPLAT_TARGET_LOSSLESS, 0) == SSPLAT_STATUS_OK);
    for (int format = SSPLAT_FORMAT_RGBA8; format <= SSPLAT_FORMAT_BGRA8_PREMULTIPLIED; format++)
        for (size_t padding = 0; padding <= 5; padding += 5) {
            struct file file = {0};
            ssplat_pixels pixels = picture(format, padding);
            ssplat_report report;
            ssplat_info info;
            CHECK(ssplat_encoder_encode(encoder, &pixels, append, &file) == SSPLAT_STATUS_OK);
            CHECK(ssplat_encoder_report(encoder, &report) == SSPLAT_STATUS_OK);
            CHECK(report.bytes == file.length && isinf(report.psnr) && isnan(report.quality));
            file.step = 1 + padding;
            CHECK(ssplat_decoder_open_callback(decoder, next, &file) == SSPLAT_STATUS_OK);
            CHECK(ssplat_decoder_info(decoder, &info) == SSPLAT_STATUS_OK && info.width == WIDTH && info.height == HEIGHT);
            ssplat_buffer buffer = {.data = malloc(pixels.size), .size = pixels.size, .stride = pixels.stride, .format = format};
            memset(buffer.data, 0, buffer.size);
            CHECK(ssplat_decoder_decode(decoder, NULL, &buffer) == SSPLAT_STATUS_OK);
            for (size_t y = 0; y < HEIGHT; y++) {
                size_t row = WIDTH * bytes_of(format), at = y * (row + padding);
                CHECK(!memcmp((const char *)buffer.data + at, (const char *)pixels.data + at, row));
            }
            /* A format that drops alpha or colours is refused. */
            buffer.stride = 0;
            buffer.format = SSPLAT_FORMAT_RGB8;
            int has_alpha = info.channels == 2 || info.channels == 4;
            ssplat_view view = {.out_width = 4, .out_height = 4};
            CHECK(ssplat_decoder_decode(decoder, &view, &buffer) == (has_alpha ? SSPLAT_STATUS_PARAMETER : SSPLAT_STATUS_OK));
            buffer.format = SSPLAT_FORMAT_GREY8;
            CHECK(ssplat_decoder_decode(decoder, &view, &buffer) == (info.channels > 1 ? SSPLAT_STATUS_PARAMETER : SSPLAT_STATUS_OK));
            uint32_t width, height;
            CHECK(ssplat_decoder_thumbnail(decoder, 8, 4, &buffer, &width, &height) == (info.channels > 1 ? SSPLAT_STATUS_PARAMETER : SSPLAT_STATUS_OK));
            free(buffer.data);
            free((void *)pixels.data);
        }
}

static void targets_and_metadata(ssplat_encoder *encoder, ssplat_decoder *decoder)
{
    ssplat_pixels pixels = picture(SSPLAT_FORMAT_RGB8, 0);
    ssplat_report report;
    struct file first = {0}, second = {0};
    const unsigned char exif[] = {'I', 'I', 42, 0, 8, 0, 0, 0, 1, 0, 0x12, 1, 3, 0, 1, 0, 0, 0, 6, 0, 0, 0, 0, 0, 0, 0};
    const char profile[] = "no profile, which the library does not look at";
    char copy[64];
    size_t length;
    CHECK(ssplat_encoder_set_target(encoder, SSPLAT_TARGET_BYTES, 150) == SSPLAT_STATUS_OK);
    CHECK(ssplat_encoder_set_option(encoder, SSPLAT_OPTION_EFFORT, 1) == SSPLAT_STATUS_OK);
    CHECK(ssplat_encoder_encode(encoder, &pixels, append, &first) == SSPLAT_STATUS_OK && first.length <= 150);
    /* Threads do not change a file. */
    CHECK(ssplat_encoder_set_option(encoder, SSPLAT_OPTION_THREADS, 3) == SSPLAT_STATUS_OK);
    CHECK(ssplat_encoder_encode(encoder, &pixels, append, &second) == SSPLAT_STATUS_OK);
    CHECK(first.length == second.length && !memcmp(first.bytes, second.bytes, first.length));
    CHECK(ssplat_encoder_set_target(encoder, SSPLAT_TARGET_QUALITY, 60) == SSPLAT_STATUS_OK);
    CHECK(ssplat_encoder_set_metadata(encoder, SSPLAT_METADATA_ICC, profile, sizeof profile) == SSPLAT_STATUS_OK);
    CHECK(ssplat_encoder_set_metadata(encoder, SSPLAT_METADATA_EXIF, exif, sizeof exif) == SSPLAT_STATUS_OK);
    first.length = 0;
    CHECK(ssplat_encoder_encode(encoder, &pixels, append, &first) == SSPLAT_STATUS_OK);
    CHECK(ssplat_encoder_report(encoder, &report) == SSPLAT_STATUS_OK && report.quality >= 59.5 && report.bytes == first.length);
    ssplat_info info;
    CHECK(ssplat_decoder_open_memory(decoder, first.bytes, first.length) == SSPLAT_STATUS_OK);
    CHECK(ssplat_decoder_info(decoder, &info) == SSPLAT_STATUS_OK && info.orientation == 6 && info.channels == 3);
    CHECK(ssplat_decoder_metadata(decoder, SSPLAT_METADATA_ICC, copy, sizeof copy, &length) == SSPLAT_STATUS_OK);
    CHECK(length == sizeof profile && !memcmp(copy, profile, length));
    /* Code points: BT.2020 primaries, PQ. */
    const unsigned char hdr[] = {9, 16, 0, 1}, ycbcr[] = {9, 16, 9, 1};
    CHECK(ssplat_encoder_set_metadata(encoder, SSPLAT_METADATA_CICP, hdr, sizeof hdr) == SSPLAT_STATUS_OK);
    CHECK(ssplat_encoder_set_metadata(encoder, SSPLAT_METADATA_CICP, ycbcr, sizeof ycbcr) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_encoder_set_metadata(encoder, SSPLAT_METADATA_CICP, hdr, 3) == SSPLAT_STATUS_PARAMETER);
    first.length = 0;
    CHECK(ssplat_encoder_encode(encoder, &pixels, append, &first) == SSPLAT_STATUS_OK);
    CHECK(ssplat_decoder_open_memory(decoder, first.bytes, first.length) == SSPLAT_STATUS_OK);
    CHECK(ssplat_decoder_metadata(decoder, SSPLAT_METADATA_CICP, copy, sizeof copy, &length) == SSPLAT_STATUS_OK);
    CHECK(length == sizeof hdr && !memcmp(copy, hdr, length));
    CHECK(ssplat_encoder_set_metadata(encoder, SSPLAT_METADATA_CICP, NULL, 0) == SSPLAT_STATUS_OK);
    /* Taken away again. */
    CHECK(ssplat_encoder_set_metadata(encoder, SSPLAT_METADATA_ICC, NULL, 0) == SSPLAT_STATUS_OK);
    CHECK(ssplat_encoder_set_metadata(encoder, SSPLAT_METADATA_EXIF, NULL, 0) == SSPLAT_STATUS_OK);
    second.length = 0;
    CHECK(ssplat_encoder_encode(encoder, &pixels, append, &second) == SSPLAT_STATUS_OK && second.length + sizeof profile < first.length);
    free((void *)pixels.data);
}

static void wrong_arguments(ssplat_encoder *encoder)
{
    ssplat_pixels pixels = picture(SSPLAT_FORMAT_RGB8, 0), bad;
    ssplat_report report;
    ssplat_encoder *fresh = ssplat_encoder_new(), *none = NULL;
    char text[128];
    struct file file = {0};
    CHECK(ssplat_encoder_free(NULL) == SSPLAT_STATUS_OK && ssplat_encoder_free(&none) == SSPLAT_STATUS_OK);
    CHECK(ssplat_encoder_encode(NULL, &pixels, append, &file) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_encoder_set_target(NULL, 0, 70) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_encoder_set_option(NULL, 0, 1) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_encoder_set_metadata(NULL, 0, NULL, 0) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_encoder_set_callback(NULL, NULL, NULL) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_encoder_report(NULL, &report) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_encoder_report(fresh, &report) == SSPLAT_STATUS_CLOSED);
    CHECK(ssplat_encoder_message(NULL, text, sizeof text) == strlen("the encoder is NULL") && !strcmp(text, "the encoder is NULL"));
    CHECK(ssplat_encoder_free(&fresh) == SSPLAT_STATUS_OK && !fresh);
    CHECK(ssplat_encoder_set_target(encoder, -1, 70) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_encoder_set_target(encoder, 6, 70) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_encoder_set_target(encoder, SSPLAT_TARGET_BYTES, 10.5) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_encoder_set_target(encoder, SSPLAT_TARGET_GAUSSIANS, NAN) == SSPLAT_STATUS_PARAMETER);
    for (int option = -1; option <= 10; option++)
        CHECK(ssplat_encoder_set_option(encoder, option, -2) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_encoder_set_option(encoder, SSPLAT_OPTION_EFFORT, 10) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_encoder_message(encoder, text, sizeof text) && strstr(text, "effort is 10"));
    CHECK(ssplat_encoder_set_option(encoder, SSPLAT_OPTION_TUNE, 4) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_encoder_set_metadata(encoder, SSPLAT_METADATA_THUMBNAIL, "x", 1) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_encoder_set_metadata(encoder, SSPLAT_METADATA_ICC, NULL, 1) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_encoder_encode(encoder, NULL, append, &file) == SSPLAT_STATUS_PARAMETER);
    CHECK(ssplat_encoder_encode(encoder, &pixels, NULL, &file) == SSPLAT_STATUS_PARAMETER);
    for (int k = 0; k < 7; k++) {
        bad = pixels;
        switch (k) {
        case 0: bad.data = NULL; break;
        case 1: bad.size--; break;
        case 2: bad.stride = 3 * WIDTH - 1; break;
        case 3: bad.format = 9; break;
        case 4: bad.reserved[2] = 1; break;
        case 5: bad.width = 0; break;
        case 6: bad.height = UINT32_MAX, bad.width = UINT32_MAX; break;
        }
        ssplat_status status = ssplat_encoder_encode(encoder, &bad, append, &file);
        CHECK(status == (k == 1 ? SSPLAT_STATUS_BUFFER : k == 6 ? SSPLAT_STATUS_LIMIT : SSPLAT_STATUS_PARAMETER));
    }
    const double refused[][2] = {{SSPLAT_TARGET_QUALITY, 101}, {SSPLAT_TARGET_RATIO, 0}, {SSPLAT_TARGET_PSNR, INFINITY}};
    for (int k = 0; k < 3; k++) {
        CHECK(ssplat_encoder_set_target(encoder, (int)refused[k][0], refused[k][1]) == SSPLAT_STATUS_OK);
        CHECK(ssplat_encoder_encode(encoder, &pixels, append, &file) == SSPLAT_STATUS_PARAMETER);
    }
    CHECK(ssplat_encoder_set_target(encoder, SSPLAT_TARGET_BYTES, 3) == SSPLAT_STATUS_OK);
    CHECK(ssplat_encoder_encode(encoder, &pixels, append, &file) == SSPLAT_STATUS_SIZE);
    CHECK(ssplat_encoder_report(encoder, &report) == SSPLAT_STATUS_CLOSED && file.length == 0);
    free((void *)pixels.data);
}

static void cancelled_and_unwritten(ssplat_encoder *encoder)
{
    ssplat_pixels pixels = picture(SSPLAT_FORMAT_RGB8, 0);
    struct watcher watcher = {encoder, 0, 0};
    struct file file = {0};
    char text[128];
    CHECK(ssplat_encoder_set_target(encoder, SSPLAT_TARGET_RATIO, 5) == SSPLAT_STATUS_OK);
    CHECK(ssplat_encoder_set_callback(encoder, watch, &watcher) == SSPLAT_STATUS_OK);
    CHECK(ssplat_encoder_encode(encoder, &pixels, append, &file) == SSPLAT_STATUS_OK && watcher.calls > 2);
    watcher = (struct watcher){encoder, 0, 2};
    file.length = 0;
    CHECK(ssplat_encoder_encode(encoder, &pixels, append, &file) == SSPLAT_STATUS_CANCELLED && watcher.calls == 2 && file.length == 0);
    CHECK(ssplat_encoder_set_callback(encoder, NULL, NULL) == SSPLAT_STATUS_OK);
    CHECK(ssplat_encoder_encode(encoder, &pixels, full, NULL) == SSPLAT_STATUS_IO);
    CHECK(ssplat_encoder_message(encoder, text, sizeof text) && strstr(text, "28"));
    CHECK(ssplat_encoder_encode(encoder, &pixels, append, &file) == SSPLAT_STATUS_OK);
    free((void *)pixels.data);
}

/* A file byte by byte: nothing is drawn, then parts, then all of it. */
static void bytes_that_arrive(ssplat_decoder *decoder, const char *folder)
{
    char path[1024];
    size_t size;
    snprintf(path, sizeof path, "%s/valid/groups-levels/file.ssplat", folder);
    char *bytes = read_file(path, &size);
    ssplat_info info = {0};
    ssplat_missing missing;
    int drawn = 0, waits = 0;
    unsigned char corner[4 * 8 * 8];
    ssplat_view view = {.out_width = 8, .out_height = 8};
    ssplat_buffer buffer = {.data = corner, .size = sizeof corner, .format = SSPLAT_FORMAT_RGBA8};
    CHECK(ssplat_decoder_set_partial(decoder, 1) == SSPLAT_STATUS_OK);
    CHECK(ssplat_decoder_begin(decoder) == SSPLAT_STATUS_OK);
    uint32_t before = UINT32_MAX;
    for (size_t k = 0; k < size; k++) {
        CHECK(ssplat_decoder_append(decoder, bytes + k, 1) == SSPLAT_STATUS_OK);
        ssplat_status status = ssplat_decoder_decode(decoder, &view, &buffer);
        if (status == SSPLAT_STATUS_OK) {
            CHECK(ssplat_decoder_info(decoder, &info) == SSPLAT_STATUS_OK);
            CHECK(ssplat_decoder_missing(decoder, &missing) == SSPLAT_STATUS_OK);
            CHECK(missing.gaussians <= before && missing.damaged == (k + 1 < size));
            before = missing.gaussians;
            drawn++;
        } else {
            CHECK(status == SSPLAT_STATUS_TRUNCATED && !drawn);
            waits++;
        }
    }
    CHECK(waits > 10 && drawn > 10 && before == 0);
    CHECK(ssplat_decoder_set_partial(decoder, 0) == SSPLAT_STATUS_OK);
    CHECK(ssplat_decoder_decode(decoder, &view, &buffer) == SSPLAT_STATUS_OK);
    free(bytes);
}

static void broken_callbacks(ssplat_decoder *decoder)
{
    ssplat_info info;
    char text[128];
    for (int negative = 0; negative < 2; negative++) {
        CHECK(ssplat_decoder_open_callback(decoder, broken, &negative) == SSPLAT_STATUS_IO);
        CHECK(ssplat_decoder_message(decoder, text, sizeof text) && strstr(text, negative ? "-1" : "5"));
        CHECK(ssplat_decoder_info(decoder, &info) == SSPLAT_STATUS_CLOSED);
    }
}

int main(int argc, char **argv)
{
    if (argc != 2)
        return 2;
    ssplat_encoder *encoder = ssplat_encoder_new();
    ssplat_decoder *decoder = ssplat_decoder_new();
    every_format_comes_back_without_loss(encoder, decoder);
    targets_and_metadata(encoder, decoder);
    wrong_arguments(encoder);
    cancelled_and_unwritten(encoder);
    bytes_that_arrive(decoder, argv[1]);
    broken_callbacks(decoder);
    CHECK(ssplat_encoder_free(&encoder) == SSPLAT_STATUS_OK && !encoder);
    CHECK(ssplat_decoder_free(&decoder) == SSPLAT_STATUS_OK);
    printf("%d checks, %d wrong\n", checks, wrong);
    return wrong != 0;
}
