/* Any bytes through every function, into buffers that are exactly as large as they must be.
 * With libFuzzer: clang -fsanitize=fuzzer,address -DLIBFUZZER. Without: fuzz ROUNDS FILE..., each file changed that often. */
#include <stdint.h>

#include "files.h"
#include "ssplat.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    ssplat_decoder *decoder = ssplat_decoder_new();
    ssplat_info info;
    size_t length;
    uint32_t width, height;
    int choice = size ? data[size - 1] : 0;
    ssplat_decoder_set_limit(decoder, SSPLAT_LIMIT_ALLOC, 16 << 20);
    ssplat_decoder_set_limit(decoder, SSPLAT_LIMIT_WORK, 1 << 26);
    ssplat_decoder_set_limit(decoder, SSPLAT_LIMIT_GAUSSIANS, 1 << 16);
    ssplat_decoder_set_partial(decoder, choice & 1);
    if (ssplat_decoder_open_memory(decoder, data, size) == SSPLAT_STATUS_OK && ssplat_decoder_info(decoder, &info) == SSPLAT_STATUS_OK) {
        for (int which = SSPLAT_METADATA_ICC; which <= SSPLAT_METADATA_THUMBNAIL; which++)
            if (!ssplat_decoder_metadata(decoder, which, NULL, 0, &length) && length) {
                void *bytes = malloc(length);
                if (ssplat_decoder_metadata(decoder, which, bytes, length, &length))
                    abort();
                free(bytes);
            }
        if (choice & 2)
            ssplat_decoder_preload(decoder);
        int format = choice >> 2 & 1 ? SSPLAT_FORMAT_RGBA16 : SSPLAT_FORMAT_RGBA8;
        size_t pixel = format == SSPLAT_FORMAT_RGBA16 ? 8 : 4;
        if (choice == 64)
            format = SSPLAT_FORMAT_BGRA8_PREMULTIPLIED;
        else if (choice > 128)
            pixel = (const size_t[]){6, 1, 2, 2, 4, 4, 8, 3}[choice & 7], format = (const int[]){SSPLAT_FORMAT_RGB16, SSPLAT_FORMAT_GREY8,
                SSPLAT_FORMAT_GREY16, SSPLAT_FORMAT_GREY_ALPHA8, SSPLAT_FORMAT_GREY_ALPHA16, SSPLAT_FORMAT_RGBA8, SSPLAT_FORMAT_RGBA16, SSPLAT_FORMAT_RGB8}[choice & 7];
        ssplat_view view = {.out_width = 1 + (choice >> 3), .out_height = 7};
        size_t bytes = pixel * view.out_width * view.out_height;
        ssplat_buffer buffer = {.data = malloc(bytes), .size = bytes, .format = format};
        ssplat_decoder_decode(decoder, &view, &buffer);
        if (info.width >= 8 && info.height >= 8) {
            view = (ssplat_view){.x = info.width - 8, .y = info.height / 2, .width = 8, .height = 4};
            buffer.size = pixel * 32;
            if (buffer.size <= bytes)
                ssplat_decoder_decode(decoder, &view, &buffer);
        }
        free(buffer.data);
        if (!ssplat_decoder_thumbnail(decoder, 9, 9, NULL, &width, &height)) {
            bytes = pixel * width * height;
            buffer = (ssplat_buffer){.data = malloc(bytes), .size = bytes, .format = format};
            ssplat_decoder_thumbnail(decoder, 9, 9, &buffer, &width, &height);
            free(buffer.data);
        }
    }
    /* The same bytes in two parts, of which the first is drawn if that can be. */
    if (choice & 1 && ssplat_decoder_begin(decoder) == SSPLAT_STATUS_OK) {
        uint8_t corner[4 * 4];
        ssplat_view view = {.out_width = 2, .out_height = 2};
        ssplat_buffer buffer = {.data = corner, .size = sizeof corner, .format = SSPLAT_FORMAT_RGBA8};
        size_t first = size / 2 + choice % (size / 2 + 1);
        if (ssplat_decoder_append(decoder, data, first) == SSPLAT_STATUS_OK) {
            ssplat_decoder_decode(decoder, &view, &buffer);
            if (ssplat_decoder_append(decoder, data + first, size - first) == SSPLAT_STATUS_OK)
                ssplat_decoder_decode(decoder, &view, &buffer);
        }
    }
    if (ssplat_decoder_free(&decoder) != SSPLAT_STATUS_OK)
        abort();
    return 0;
}

#ifndef LIBFUZZER
static uint64_t state = 1;

static size_t below(size_t most)
{
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (size_t)(state >> 33) % most;
}

int main(int argc, char **argv)
{
    long rounds = argc > 2 ? atol(argv[1]) : 0, runs = 0;
    for (int i = 2; i < argc; i++) {
        size_t size;
        char *file = read_file(argv[i], &size);
        for (long round = 0; round < rounds; round++, runs++) {
            size_t kept = round && below(4) == 0 ? below(size + 1) : size;
            uint8_t *bytes = malloc(kept + 1);
            memcpy(bytes, file, kept);
            for (size_t changes = round ? below(4) : 0; kept && changes > 0; changes--)
                bytes[below(kept)] = (uint8_t)below(256);
            LLVMFuzzerTestOneInput(bytes, kept);
            free(bytes);
        }
        free(file);
    }
    printf("%ld runs\n", runs);
    return runs == 0;
}
#endif
