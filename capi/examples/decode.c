/* Decodes a .ssplat file to a PAM file with RGBA of 8 bits: decode IN.ssplat OUT.pam [MAX_WIDTH MAX_HEIGHT]
 * With a size, the picture is fitted into it. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

#include "ssplat.h"

/* A program would look here whether its user still waits. */
static int on_progress(void *user, float done)
{
    (void)user;
    fprintf(stderr, "\r%3.0f %%%s", 100 * done, done == 1 ? "\n" : "");
    return 0;
}

static int failed(const ssplat_decoder *decoder, ssplat_status status)
{
    char message[512];
    ssplat_decoder_message(decoder, message, sizeof message);
    fprintf(stderr, "\n%s: %s\n", ssplat_status_name(status), message);
    return 1;
}

static int write_pam(const char *path, uint32_t width, uint32_t height, const void *pixels, size_t size)
{
    FILE *file = fopen(path, "wb");
    if (!file) {
        perror(path);
        return 1;
    }
    fprintf(file, "P7\nWIDTH %" PRIu32 "\nHEIGHT %" PRIu32 "\nDEPTH 4\nMAXVAL 255\nTUPLTYPE RGB_ALPHA\nENDHDR\n", width, height);
    int bad = fwrite(pixels, 1, size, file) != size;
    if (fclose(file) || bad) {
        perror(path);
        return 1;
    }
    return 0;
}

int main(int argc, char **argv)
{
    if (argc != 3 && argc != 5) {
        fprintf(stderr, "usage: %s IN.ssplat OUT.pam [MAX_WIDTH MAX_HEIGHT]\n", argv[0]);
        return 2;
    }
    ssplat_decoder *decoder = ssplat_decoder_new();
    if (!decoder)
        return 1;
    ssplat_buffer buffer = {.format = SSPLAT_FORMAT_RGBA8};
    ssplat_info info = {0};
    int result = 1;

    ssplat_status status = ssplat_decoder_open_file(decoder, argv[1]);
    if (status == SSPLAT_STATUS_OK)
        status = ssplat_decoder_set_callback(decoder, on_progress, NULL);
    if (status == SSPLAT_STATUS_OK)
        status = ssplat_decoder_info(decoder, &info);
    uint32_t width = info.width, height = info.height;
    uint32_t most[2] = {argc == 5 ? strtoul(argv[3], NULL, 10) : 0, argc == 5 ? strtoul(argv[4], NULL, 10) : 0};
    if (status == SSPLAT_STATUS_OK && argc == 5)
        status = ssplat_decoder_thumbnail(decoder, most[0], most[1], NULL, &width, &height);
    if (status != SSPLAT_STATUS_OK) {
        failed(decoder, status);
        goto end;
    }
    if (height > SIZE_MAX / 4 / width || !(buffer.data = malloc(buffer.size = (size_t)4 * width * height))) {
        fprintf(stderr, "no memory for %" PRIu32 " x %" PRIu32 " pixels\n", width, height);
        goto end;
    }
    if (argc == 5)
        status = ssplat_decoder_thumbnail(decoder, most[0], most[1], &buffer, &width, &height);
    else
        status = ssplat_decoder_decode(decoder, NULL, &buffer);
    result = status == SSPLAT_STATUS_OK ? write_pam(argv[2], width, height, buffer.data, buffer.size)
                                        : failed(decoder, status);
end:
    free(buffer.data);
    ssplat_decoder_free(&decoder);
    return result;
}
