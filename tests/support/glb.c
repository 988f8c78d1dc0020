#include "glb.h"

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void put_u32(unsigned char *bytes, size_t value)
{
    for (int i = 0; i < 4; i++)
        bytes[i] = (unsigned char)(value >> (8 * i));
}

struct glb glb_make(const char *json, const void *binary, size_t binary_size)
{
    size_t text = strlen(json), text_whole = (text + 3) / 4 * 4, binary_whole = (binary_size + 3) / 4 * 4;
    struct glb glb = {.size = 20 + text_whole + (binary_size ? 8 + binary_whole : 0)};
    glb.bytes = calloc(1, glb.size);
    if (!glb.bytes)
        abort();
    memcpy(glb.bytes, "glTF", 4);
    put_u32(glb.bytes + 4, 2);
    put_u32(glb.bytes + 8, glb.size);
    put_u32(glb.bytes + 12, text_whole);
    memcpy(glb.bytes + 16, "JSON", 4);
    memset(glb.bytes + 20, ' ', text_whole);
    memcpy(glb.bytes + 20, json, text);
    if (binary_size) {
        put_u32(glb.bytes + 20 + text_whole, binary_whole);
        memcpy(glb.bytes + 24 + text_whole, "BIN", 4);
        memcpy(glb.bytes + 28 + text_whole, binary, binary_size);
    }
    return glb;
}

struct scene *glb_import(const char *json, const void *binary, size_t binary_size, struct error *error)
{
    struct glb glb = glb_make(json, binary, binary_size);
    struct scene *scene = scene_import_memory(glb.bytes, glb.size, error);
    free(glb.bytes);
    return scene;
}

const char *glb_quote(const char *text)
{
    static char quoted[65536];
    snprintf(quoted, sizeof quoted, "%s", text);
    for (char *c = quoted; *c; c++)
        if (*c == '\'')
            *c = '"';
    return quoted;
}

bool scene_warns(const struct scene *scene, const char *text)
{
    for (uint32_t i = 0; i < scene->warning_count; i++)
        if (strstr(scene->warnings[i], text))
            return true;
    return false;
}
