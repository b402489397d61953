/* Holds the library against spec/vectors: vectors FOLDER. Valid files give the pictures within the tolerance that case.txt
 * states, at their own depth and at the other; others are refused with the kind that it names. */
#include <dirent.h>
#include <stdint.h>

#include "files.h"
#include "ssplat.h"

static int checked, wrong;

static void complain(const char *name, const char *what)
{
    fprintf(stderr, "%s: %s\n", name, what);
    wrong++;
}

/* The value of a field of case.txt, or NULL. */
static const char *field(const char *text, const char *name)
{
    size_t length = strlen(name);
    for (const char *line = text; line; line = (line = strchr(line, '\n')) ? line + 1 : NULL)
        if (!strncmp(line, name, length) && !strncmp(line + length, ": ", 2))
            return line + length + 2;
    return NULL;
}

static int begins(const char *text, const char *word)
{
    return text && !strncmp(text, word, strlen(word));
}

struct pam {
    unsigned width, height, channels, top;
    const unsigned char *body;
};

static int parse_pam(const char *bytes, size_t size, struct pam *pam)
{
    const char *body = strstr(bytes, "ENDHDR\n");
    if (sscanf(bytes, "P7\nWIDTH %u\nHEIGHT %u\nDEPTH %u\nMAXVAL %u\n", &pam->width, &pam->height, &pam->channels, &pam->top) != 4 || !body)
        return 0;
    pam->body = (const unsigned char *)body + 7;
    return size - (size_t)(body + 7 - bytes) == (size_t)pam->width * pam->height * pam->channels * (pam->top > 255 ? 2 : 1);
}

/* Sample k of pixel i of the picture as RGBA, 0 to `top`. */
static unsigned wanted(const struct pam *pam, size_t i, unsigned k)
{
    unsigned colors = pam->channels > 2 ? 3 : 1, at = k == 3 ? colors : colors == 3 ? k : 0;
    size_t sample = i * pam->channels + at;
    if (k == 3 && pam->channels != 2 && pam->channels != 4)
        return pam->top;
    return pam->top > 255 ? 256u * pam->body[2 * sample] + pam->body[2 * sample + 1] : pam->body[sample];
}

/* Compares decoded pixels with a picture, in code values of the picture's depth. */
static int is_within(const struct pam *pam, const unsigned char *pixels, size_t stride, int format, double tolerance, int reduced)
{
    for (size_t i = 0; i < (size_t)pam->width * pam->height; i++)
        for (unsigned k = 0; k < 4; k++) {
            const unsigned char *row = pixels + i / pam->width * stride;
            uint16_t wide;
            memcpy(&wide, row + (i % pam->width * 4 + k) * 2 * (format == SSPLAT_FORMAT_RGBA16), 2 * (format == SSPLAT_FORMAT_RGBA16));
            double got = format == SSPLAT_FORMAT_RGBA16 ? wide / 65535.0 : row[i % pam->width * 4 + k] / 255.0;
            double off = got * pam->top - wanted(pam, i, k), weight = 1;
            if (reduced && k < 3 && wanted(pam, i, 3) < pam->top / 16.0)
                weight = 16.0 * wanted(pam, i, 3) / pam->top;
            /* Both pictures are rounded once more where the depths differ. */
            double rounding = (format == SSPLAT_FORMAT_RGBA16) == (pam->top > 255) ? 1e-6 : .5 + (pam->top > 255 ? 128.5 : 0);
            if ((off < 0 ? -off : off) * weight > tolerance + rounding)
                return 0;
        }
    return 1;
}

/* The word of case.txt for a status: a file that is cut off breaks the format. */
static const char *kind_of(ssplat_status status)
{
    if (status == SSPLAT_STATUS_VERSION)
        return "unsupported";
    return ssplat_status_name(status == SSPLAT_STATUS_TRUNCATED ? SSPLAT_STATUS_FORMAT : status);
}

static void check_picture(const char *name, ssplat_decoder *decoder, const char *text, const struct pam *pam)
{
    ssplat_view view = {0};
    ssplat_info info;
    int reduced = field(text, "size") != NULL;
    double tolerance = atof(field(text, "tolerance"));
    if (reduced && sscanf(field(text, "size"), "%u %u", &view.out_width, &view.out_height) != 2)
        complain(name, "no size");
    if (ssplat_decoder_info(decoder, &info) || info.channels != pam->channels || (1u << info.bits) - 1 != pam->top)
        complain(name, "info differs");
    for (int format = SSPLAT_FORMAT_RGBA8; format <= SSPLAT_FORMAT_RGBA16; format++)
        for (int padding = 0; padding <= 5; padding += 5) {
            size_t row = (size_t)pam->width * 4 * (format == SSPLAT_FORMAT_RGBA16 ? 2 : 1), stride = row + padding;
            /* Exactly as large as it must be, so that a sanitizer sees a byte too many; odd strides are not aligned. */
            size_t size = stride * (pam->height - 1) + row;
            ssplat_buffer buffer = {.data = malloc(size), .size = size, .stride = padding ? stride : 0, .format = format};
            if (!buffer.data)
                exit(1);
            memset(buffer.data, 0x5a, size);
            ssplat_status status = ssplat_decoder_decode(decoder, &view, &buffer);
            char message[256];
            ssplat_decoder_message(decoder, message, sizeof message);
            if (status != SSPLAT_STATUS_OK)
                complain(name, message);
            else if (!is_within(pam, buffer.data, stride, format, tolerance, reduced))
                complain(name, "pixels differ");
            for (size_t y = 0; y + 1 < pam->height; y++)
                for (size_t x = row; x < stride; x++)
                    if (((unsigned char *)buffer.data)[y * stride + x] != 0x5a)
                        complain(name, "bytes between rows were written"), x = stride, y = pam->height - 2;
            free(buffer.data);
        }
}

static void check_refused(const char *name, ssplat_decoder *decoder, const char *kind)
{
    /* What is refused is refused before a byte is written, so that large pictures need not have their memory. */
    ssplat_info info;
    ssplat_status status = ssplat_decoder_info(decoder, &info);
    if (status == SSPLAT_STATUS_OK) {
        uint64_t size = (uint64_t)4 * info.width * info.height;
        ssplat_buffer buffer = {.data = malloc(size < 1 << 20 ? size : 1), .size = size, .format = SSPLAT_FORMAT_RGBA8};
        if (!buffer.data)
            exit(1);
        status = ssplat_decoder_decode(decoder, NULL, &buffer);
        free(buffer.data);
    }
    if (!begins(kind, kind_of(status)))
        complain(name, ssplat_status_name(status));
}

static void check(const char *folder, const char *name, int partial)
{
    char path[1024], label[600];
    size_t size, file_size, pam_size;
    snprintf(label, sizeof label, "%s/%s", strrchr(folder, '/') + 1, name);
    snprintf(path, sizeof path, "%s/%s/case.txt", folder, name);
    char *text = read_file(path, &size);
    snprintf(path, sizeof path, "%s/%s/file.ssplat", folder, name);
    char *file = read_file(path, &file_size);
    ssplat_decoder *decoder = ssplat_decoder_new();
    ssplat_decoder_set_partial(decoder, partial);
    ssplat_decoder_set_limit(decoder, SSPLAT_LIMIT_ALLOC, (uint64_t)1 << 30);
    /* From memory and from the file in turns; memory is exactly as long as the file, and gone before decoding. */
    ssplat_status status;
    if (checked % 2) {
        status = ssplat_decoder_open_file(decoder, path);
    } else {
        void *exact = malloc(file_size ? file_size : 1);
        memcpy(exact, file, file_size);
        status = ssplat_decoder_open_memory(decoder, exact, file_size);
        free(exact);
    }
    checked++;
    if (begins(field(text, "expect"), "picture")) {
        struct pam pam;
        snprintf(path, sizeof path, "%s/%s/picture.pam", folder, name);
        char *picture = read_file(path, &pam_size);
        if (!parse_pam(picture, pam_size, &pam))
            complain(label, "picture.pam cannot be read");
        else if (status != SSPLAT_STATUS_OK)
            complain(label, ssplat_status_name(status));
        else
            check_picture(label, decoder, text, &pam);
        free(picture);
    } else if (status == SSPLAT_STATUS_OK) {
        check_refused(label, decoder, field(text, "kind"));
    } else if (!begins(field(text, "kind"), kind_of(status))) {
        complain(label, ssplat_status_name(status));
    }
    ssplat_decoder_free(&decoder);
    free(file);
    free(text);
}

int main(int argc, char **argv)
{
    const char *folders[] = {"valid", "invalid", "limits", "reduced", "partial"};
    for (int f = 0; f < 5 && argc == 2; f++) {
        char folder[512];
        snprintf(folder, sizeof folder, "%s/%s", argv[1], folders[f]);
        DIR *directory = opendir(folder);
        if (!directory) {
            perror(folder);
            return 1;
        }
        for (struct dirent *entry; (entry = readdir(directory));)
            if (entry->d_name[0] != '.')
                check(folder, entry->d_name, f == 4);
        closedir(directory);
    }
    printf("%d vectors, %d wrong\n", checked, wrong);
    return wrong || checked < 100;
}
