/* bench_shaders.h: the compiled shaders of bench/shaders/. */
#ifndef BENCH_SHADERS_H
#define BENCH_SHADERS_H

#include <stddef.h>
#include <stdint.h>

/* As shader_find in shaders/shader_table.h. */
const uint32_t *bench_shader_find(const char *name, size_t *bytes);

#endif
