/* Whole files to memory, for the tests. */
#ifndef FILES_H
#define FILES_H
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Returns the bytes of a file and a zero behind them, and their number; exits if that fails. */
static char *read_file(const char *path, size_t *size)
{
    FILE *file = fopen(path, "rb");
    long length;
    char *bytes;
    if (!file || fseek(file, 0, SEEK_END) || (length = ftell(file)) < 0 || fseek(file, 0, SEEK_SET)) {
        perror(path);
        exit(1);
    }
    bytes = malloc((size_t)length + 1);
    if (!bytes || fread(bytes, 1, (size_t)length, file) != (size_t)length) {
        perror(path);
        exit(1);
    }
    fclose(file);
    bytes[length] = 0;
    *size = (size_t)length;
    return bytes;
}
#endif
