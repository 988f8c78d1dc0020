/* glb.h: GLB files made of a JSON text and a binary chunk, and scenes imported from them. */
#ifndef TEST_GLB_H
#define TEST_GLB_H

#include "core/scene/scene.h"

struct glb {
    unsigned char *bytes; /* malloc'ed */
    size_t size;
};

/* Padded as glTF asks; `binary_size` 0: no second chunk. Ends the program when out of memory. */
struct glb glb_make(const char *json, const void *binary, size_t binary_size);

/* Imports a GLB of these from memory. */
struct scene *glb_import(const char *json, const void *binary, size_t binary_size, struct error *error);

/* The text with every ' made a ": JSON can then be written in C without backslashes. Static storage, one text
 * at a time. */
const char *glb_quote(const char *text);

/* Whether one of the scene's warnings holds the text. */
bool scene_warns(const struct scene *scene, const char *text);

/* "asset", one node with mesh 0, and what follows: the beginning of most small files. Continue with members.
 */
#define GLB_ONE_MESH                                                                                         \
    "{'asset':{'version':'2.0'},'scene':0,'scenes':[{'nodes':[0]}],'nodes':[{'name':'n','mesh':0}],"

#endif
