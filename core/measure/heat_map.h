/* heat_map.h: a number per pixel as a colour, from black over red to pale yellow.
 *
 * The colours are magma's (van der Walt and Smith, dedicated to the public domain): their lightness rises
 * evenly, so that twice the value looks twice as bright in grey print as well. FLIP's authors use them too.
 */
#ifndef CAUSTIC_HEAT_MAP_H
#define CAUSTIC_HEAT_MAP_H

#include <stddef.h>
#include <stdint.h>

/* `count` sRGB-encoded pixels for an 8-bit PNG: black at `low`, pale yellow at `high`, clamped beyond. NaN is
 * cyan, which no value has. low = high makes all that are not above it black. */
void heat_map_colors(const float *values, size_t count, double low, double high, uint8_t *rgb);

#endif
