/* markup.h: text into HTML and SVG, and files that are whole or absent. Internal to the report library. */
#ifndef CAUSTIC_MARKUP_H
#define CAUSTIC_MARKUP_H

#include <stdint.h>
#include <stdio.h>

#include "../../core/status.h"

/* With &, <, > and quotes escaped, and characters XML does not allow as '?'. NULL: nothing. */
void markup_text(FILE *stream, const char *text);
void markup_base64(FILE *stream, const uint8_t *bytes, size_t size);

/* A file under a temporary name beside `path`, which markup_close gives its name, or removes on an error. */
struct markup_file {
    char path[4000], part[4008];
    FILE *stream;
};
bool markup_open(struct markup_file *file, const char *path, struct error *error);
bool markup_close(struct markup_file *file, struct error *error);

#endif
