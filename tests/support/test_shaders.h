/* test_shaders.h: the compiled shaders of tests/shaders/. */
#ifndef TEST_SHADERS_H
#define TEST_SHADERS_H

#include <stddef.h>
#include <stdint.h>

/* As shader_find in shaders/shader_table.h. */
const uint32_t *test_shader_find(const char *name, size_t *bytes);

#endif
