/* shader_table.h: the compiled shaders, embedded in the library. */
#ifndef CAUSTIC_SHADER_TABLE_H
#define CAUSTIC_SHADER_TABLE_H

#include <stddef.h>
#include <stdint.h>

/* SPIR-V by file name ("splat.comp"); shaders that trace have the tracer's name behind
 * ("photon_trace.comp.bvh"). NULL when there is none. Static memory. */
const uint32_t *shader_find(const char *name, size_t *bytes);

#endif
