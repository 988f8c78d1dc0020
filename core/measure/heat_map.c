#include "heat_map.h"

#include <math.h>

/* Every sixteenth of magma's 256 colours, and its last. */
static const double magma[17][3] = {
    {0.001462, 0.000466, 0.013866}, {0.039608, 0.031090, 0.133515}, {0.113094, 0.065492, 0.276784},
    {0.211718, 0.061992, 0.418647}, {0.316654, 0.071690, 0.485380}, {0.414709, 0.110431, 0.504662},
    {0.512831, 0.148179, 0.507648}, {0.613617, 0.181811, 0.498536}, {0.716387, 0.214982, 0.475290},
    {0.816914, 0.255895, 0.436461}, {0.904281, 0.319610, 0.388137}, {0.960949, 0.418323, 0.359630},
    {0.986700, 0.535582, 0.382210}, {0.996096, 0.653659, 0.446213}, {0.996898, 0.769591, 0.534892},
    {0.992440, 0.884330, 0.640099}, {0.987053, 0.991438, 0.749504},
};

void heat_map_colors(const float *values, size_t count, double low, double high, uint8_t *rgb)
{
    for (size_t i = 0; i < count; i++) {
        uint8_t *pixel = rgb + 3 * i;
        double value = (double)values[i];
        if (isnan(value)) {
            pixel[0] = 0;
            pixel[1] = pixel[2] = 255;
            continue;
        }
        double share = value <= low ? 0 : value >= high ? 1 : (value - low) / (high - low);
        double place = share * 255 / 16; /* the last step is of 15 colours */
        size_t step = place >= 15 ? 15 : (size_t)place;
        double within = step == 15 ? (place - 15) * 16 / 15 : place - (double)step;
        for (int c = 0; c < 3; c++) {
            double color = magma[step][c] + within * (magma[step + 1][c] - magma[step][c]);
            pixel[c] = (uint8_t)(color * 255 + 0.5);
        }
    }
}
