/* Encodes a PGM, PPM or PAM file of 8 bits: encode IN.ppm OUT.ssplat [QUALITY]
 * The quality is an SSIMULACRA2 score; 70 is the default, and 100 stores the picture without loss. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ssplat.h"

/* A program would look here whether its user still waits. */
static int on_progress(void *user, const char *stage, float done)
{
    (void)user;
    fprintf(stderr, "\r%-12s %3.0f %%", stage, 100 * done);
    return 0;
}

static int on_write(void *user, const void *data, size_t size)
{
    return fwrite(data, 1, size, user) != size;
}

/* Reads the header, which has no comments, and the samples. Returns whether both are there; pixels->data is to be freed. */
static int read_picture(FILE *file, ssplat_pixels *pixels)
{
    const int formats[] = {SSPLAT_FORMAT_GREY8, SSPLAT_FORMAT_GREY_ALPHA8, SSPLAT_FORMAT_RGB8, SSPLAT_FORMAT_RGBA8};
    uint32_t channels = 0, top = 0;
    char kind = 0, word[16];
    if (fscanf(file, "P%c", &kind) != 1)
        return 0;
    if (kind == '7') {
        while (fscanf(file, "%15s", word) == 1 && strcmp(word, "ENDHDR")) {
            uint32_t *field = !strcmp(word, "WIDTH") ? &pixels->width : !strcmp(word, "HEIGHT") ? &pixels->height
                : !strcmp(word, "DEPTH") ? &channels : !strcmp(word, "MAXVAL") ? &top : NULL;
            if (field ? fscanf(file, "%" SCNu32, field) != 1 : fscanf(file, "%15s", word) != 1)
                return 0;
        }
    } else {
        channels = kind == '5' ? 1 : kind == '6' ? 3 : 0;
        if (fscanf(file, "%" SCNu32 "%" SCNu32 "%" SCNu32, &pixels->width, &pixels->height, &top) != 3)
            return 0;
    }
    if (fgetc(file) == EOF || top != 255 || channels < 1 || channels > 4 || !pixels->width || !pixels->height
        || pixels->height > SIZE_MAX / 4 / pixels->width)
        return 0;
    pixels->format = formats[channels - 1];
    pixels->size = (size_t)channels * pixels->width * pixels->height;
    void *data = malloc(pixels->size);
    pixels->data = data;
    return data && fread(data, 1, pixels->size, file) == pixels->size;
}

int main(int argc, char **argv)
{
    if (argc != 3 && argc != 4) {
        fprintf(stderr, "usage: %s IN.ppm OUT.ssplat [QUALITY]\n", argv[0]);
        return 2;
    }
    double quality = argc == 4 ? strtod(argv[3], NULL) : 70;
    ssplat_pixels pixels = {0};
    ssplat_report report = {0};
    ssplat_encoder *encoder = ssplat_encoder_new();
    ssplat_status status = SSPLAT_STATUS_MEMORY;
    int result = 1;
    FILE *in = fopen(argv[1], "rb"), *out = NULL;
    if (!in || !encoder) {
        perror(argv[1]);
        goto end;
    }
    if (!read_picture(in, &pixels)) {
        fprintf(stderr, "%s: no PGM, PPM or PAM file of 8 bits, or cut off\n", argv[1]);
        goto end;
    }
    if (!(out = fopen(argv[2], "wb"))) {
        perror(argv[2]);
        goto end;
    }
    status = ssplat_encoder_set_target(encoder, quality == 100 ? SSPLAT_TARGET_LOSSLESS : SSPLAT_TARGET_QUALITY, quality);
    if (status == SSPLAT_STATUS_OK)
        status = ssplat_encoder_set_callback(encoder, on_progress, NULL);
    if (status == SSPLAT_STATUS_OK)
        status = ssplat_encoder_encode(encoder, &pixels, on_write, out);
    if (status == SSPLAT_STATUS_OK)
        status = ssplat_encoder_report(encoder, &report);
    if (status == SSPLAT_STATUS_OK) {
        fprintf(stderr, "\r%" PRIu64 " bytes, %" PRIu32 " Gaussians, %.1f s\n", report.bytes, report.gaussians, report.seconds);
        result = 0;
    } else {
        char message[512];
        ssplat_encoder_message(encoder, message, sizeof message);
        fprintf(stderr, "\n%s: %s\n", ssplat_status_name(status), message);
    }
end:
    if (out && fclose(out)) {
        perror(argv[2]);
        result = 1;
    }
    if (out && result)
        remove(argv[2]);
    if (in)
        fclose(in);
    free((void *)pixels.data);
    ssplat_encoder_free(&encoder);
    return result;
}
