/* plot.h: a plot as SVG: lines and points over linear or logarithmic axes, with a legend.
 *
 * The same text stands inside a page (page.h) and in a file of its own; it follows the reader's light or dark
 * mode, and every series has a colour, a dash and a mark of its own, so that it survives a black-and-white
 * printer. A point tells its series, its values and its label to a resting mouse.
 */
#ifndef CAUSTIC_PLOT_H
#define CAUSTIC_PLOT_H

#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include "../../core/status.h"

struct plot_series {
    const char *name; /* in the legend; NULL: not there */
    const double *x, *y;
    uint32_t count; /* a point that is not finite, or not positive on a log axis, breaks the line */
    const char *const *labels; /* per point, for the mouse; NULL: none */
    bool has_line, has_marks;
    bool is_stepped; /* the line goes across, then up: a front, a held value */
    uint32_t style;  /* colour, dash and mark; 0: by its place among the series, from 1 */
};

/* Ranges come from the data where minimum and maximum are equal. */
struct plot {
    const char *title, *x_label, *y_label; /* NULL: none */
    bool is_log_x, is_log_y;
    bool is_zero_based; /* a linear y axis begins at 0 */
    double x_minimum, x_maximum, y_minimum, y_maximum;
    uint32_t width, height; /* user units; 0: 640 and 360 */
    const struct plot_series *series;
    uint32_t series_count;
};

/* Well-formed XML. Names are escaped. */
void plot_write(FILE *stream, const struct plot *plot);

/* Shares of a whole, one bar per row, one colour per part, as in pass times. `values` holds rows x parts. */
struct plot_bars {
    const char *title, *x_label;
    const char *const *rows;
    const char *const *parts;
    uint32_t row_count, part_count;
    const double *values;
    uint32_t width; /* 0: 640 */
};
void plot_bars_write(FILE *stream, const struct plot_bars *bars);

/* As a file of its own; whole or absent. */
bool plot_write_file(const char *path, const struct plot *plot, struct error *error);
bool plot_bars_write_file(const char *path, const struct plot_bars *bars, struct error *error);

/* A number for people: four digits, whole from 1000 on, with an exponent where it is very small or large. */
void plot_number(double value, char *text, size_t size);

#endif
