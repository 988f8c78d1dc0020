/* shared.h: lets one header compile as C and as GLSL. Structures hold only 4-byte scalars and arrays of them,
 * in multiples of 16 bytes, so that C and std430 agree. */
#ifndef SHARED_H
#define SHARED_H
#ifdef __cplusplus
#error "C only"
#endif
#ifndef GL_core_profile
#include <stdint.h>
typedef uint32_t uint;
typedef struct {
    float x, y, z, w;
} vec4;
typedef struct {
    float x, y;
} vec2;
typedef struct {
    uint32_t x, y, z, w;
} uvec4;
#define SHARED_SIZE(type, size) _Static_assert(sizeof(struct type) == (size), #type " must match the shader")
#else
#define SHARED_SIZE(type, size)
#endif
#endif
