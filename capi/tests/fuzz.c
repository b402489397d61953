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
    ssplat_decoder_set_limit(decoder, SSPLAT_LIMIT_PRIMITIVES, 1 << 16);
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
        int format = choice >> 2 & 1;
        ssplat_view view = {0, 0, 0, 0, 1 + (choice >> 3), 7};
        size_t bytes = (size_t)(4 << format) * view.out_width * view.out_height;
        ssplat_buffer buffer = {malloc(bytes), bytes, 0, format};
        ssplat_decoder_decode(decoder, &view, &buffer);
        if (info.width >= 8 && info.height >= 8) {
            view = (ssplat_view){info.width - 8, info.height / 2, 8, 4, 0, 0};
            buffer.size = (size_t)(4 << format) * 32;
            if (buffer.size <= bytes)
                ssplat_decoder_decode(decoder, &view, &buffer);
        }
        free(buffer.data);
        if (!ssplat_decoder_thumbnail(decoder, 9, 9, NULL, &width, &height)) {
            bytes = (size_t)(4 << format) * width * height;
            buffer = (ssplat_buffer){malloc(bytes), bytes, 0, format};
            ssplat_decoder_thumbnail(decoder, 9, 9, &buffer, &width, &height);
            free(buffer.data);
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
