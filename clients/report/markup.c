#include "markup.h"

#include <errno.h>
#include <string.h>
#include <unistd.h>

void markup_text(FILE *stream, const char *text)
{
    for (const char *at = text ? text : ""; *at; at++) {
        switch (*at) {
        case '&':
            fputs("&amp;", stream);
            break;
        case '<':
            fputs("&lt;", stream);
            break;
        case '>':
            fputs("&gt;", stream);
            break;
        case '"':
            fputs("&quot;", stream);
            break;
        default:
            fputc((unsigned char)*at < 32 && *at != '\n' && *at != '\t' ? '?' : *at, stream);
        }
    }
}

void markup_base64(FILE *stream, const uint8_t *bytes, size_t size)
{
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    for (size_t i = 0; i < size; i += 3) {
        uint32_t left = size - i < 3 ? (uint32_t)(size - i) : 3;
        uint32_t group = (uint32_t)bytes[i] << 16;
        if (left > 1)
            group |= (uint32_t)bytes[i + 1] << 8;
        if (left > 2)
            group |= bytes[i + 2];
        for (uint32_t digit = 0; digit < 4; digit++)
            fputc(digit <= left ? digits[group >> (18 - 6 * digit) & 63] : '=', stream);
    }
}

bool markup_open(struct markup_file *file, const char *path, struct error *error)
{
    if (snprintf(file->path, sizeof file->path, "%s", path) >= (int)sizeof file->path)
        return error_set(error, STATUS_INVALID, "%.100s...: the name is too long", path);
    snprintf(file->part, sizeof file->part, "%s.part", file->path);
    file->stream = fopen(file->part, "w");
    return file->stream || error_set(error, STATUS_IO, "%.300s: %s", path, strerror(errno));
}

bool markup_close(struct markup_file *file, struct error *error)
{
    errno = 0;
    bool is_whole = fflush(file->stream) == 0 && ferror(file->stream) == 0;
    int reason = errno;
    if (fclose(file->stream) != 0 && is_whole) {
        is_whole = false;
        reason = errno;
    }
    if (is_whole && rename(file->part, file->path) == 0)
        return true;
    if (is_whole)
        reason = errno;
    unlink(file->part);
    return error_set(error, STATUS_IO, "%.300s: %s", file->path,
                     reason ? strerror(reason) : "could not be written whole");
}
