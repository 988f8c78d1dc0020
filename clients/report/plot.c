#include "plot.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "markup.h"

#define DEFAULT_WIDTH  640u
#define DEFAULT_HEIGHT 360u
#define STYLE_COUNT    8u
#define MAX_TICKS      24u
#define LETTER_WIDTH   6.3 /* of the 11-unit sans serif face, on average */
#define LEGEND_LETTERS 30u
#define BAR_HEIGHT     18.0
#define BAR_STEP       26.0

/* Okabe and Ito's colours, which colour-blind readers tell apart, darkened for white and lightened for black
 * paper where their contrast wants it. */
static const char style_sheet[] =
    "<style>"
    ".cp{font:11px system-ui,sans-serif;fill:#333}"
    ".cp .t{font-weight:600;font-size:13px}"
    ".cp .g{stroke:#ddd;stroke-width:1}.cp .x{stroke:#888;stroke-width:1;fill:none}"
    ".cp .l{fill:none;stroke-width:1.8;stroke-linejoin:round}"
    ".cp .s1{stroke:#0072b2;color:#0072b2}.cp .s2{stroke:#d55e00;color:#d55e00}"
    ".cp .s3{stroke:#00845f;color:#00845f}.cp .s4{stroke:#b3528c;color:#b3528c}"
    ".cp .s5{stroke:#a67a00;color:#a67a00}.cp .s6{stroke:#3a93c4;color:#3a93c4}"
    ".cp .s7{stroke:#555;color:#555}.cp .s8{stroke:#7a4fb5;color:#7a4fb5}"
    ".cp .m{fill:currentColor;stroke:none}.cp .b{fill:currentColor;stroke:none}"
    "@media screen and (prefers-color-scheme:dark){"
    ".cp{fill:#ccc}.cp .g{stroke:#383838}"
    ".cp .s1{stroke:#4fa8e0;color:#4fa8e0}.cp .s2{stroke:#ff8a3d;color:#ff8a3d}"
    ".cp .s3{stroke:#35c08f;color:#35c08f}.cp .s4{stroke:#e08fc0;color:#e08fc0}"
    ".cp .s5{stroke:#e0b040;color:#e0b040}.cp .s6{stroke:#8fd0f5;color:#8fd0f5}"
    ".cp .s7{stroke:#aaa;color:#aaa}.cp .s8{stroke:#b394ea;color:#b394ea}}"
    "</style>";

static const char *const dashes[STYLE_COUNT] = {"", "7 3", "2 3", "9 3 2 3", "5 2", "1 2", "12 4", "4 4"};

void plot_number(double value, char *text, size_t size)
{
    if (!isfinite(value))
        snprintf(text, size, "–");
    else if (value == 0) /* of either sign */
        snprintf(text, size, "0");
    else if (value == 0)
        snprintf(text, size, "0"); /* no "-0" */
    else if (fabs(value) < 1e-4 || fabs(value) >= 1e7)
        snprintf(text, size, "%.3g", value);
    else if (fabs(value) >= 1000)
        snprintf(text, size, "%.0f", value);
    else
        snprintf(text, size, "%.4g", value);
}

/* ---- axes ---------------------------------------------------------------------------------------------- */

struct axis {
    bool is_log;
    double minimum, maximum; /* log axes: of the decimal logarithm */
    double begin, end;       /* user units */
    double ticks[MAX_TICKS];
    uint32_t tick_count;
};

static double axis_value(const struct axis *axis, double value)
{
    if (!axis->is_log)
        return value;
    return value > 0 ? log10(value) : NAN;
}

static double axis_place(const struct axis *axis, double value)
{
    double share = (axis_value(axis, value) - axis->minimum) / (axis->maximum - axis->minimum);
    return axis->begin + share * (axis->end - axis->begin);
}

static void add_tick(struct axis *axis, double value)
{
    double at = axis_value(axis, value), slack = 1e-9 * (axis->maximum - axis->minimum);
    if (axis->tick_count < MAX_TICKS && at >= axis->minimum - slack && at <= axis->maximum + slack)
        axis->ticks[axis->tick_count++] = value;
}

/* Ticks at 1, 2 and 5 times powers of ten; on a log axis of many decades at the powers alone, on one of less
 * than a decade as on a linear one. */
static void add_ticks(struct axis *axis, uint32_t wanted)
{
    static const double steps[] = {1, 2, 5};
    double low = axis->minimum, high = axis->maximum;
    if (axis->is_log) {
        double stride = ceil((high - low) / 8);
        for (double decade = floor(low); decade <= high; decade += stride)
            for (uint32_t i = 0; i < (high - low < 3 ? 3 : 1); i++)
                add_tick(axis, steps[i] * pow(10, decade));
        if (axis->tick_count > 2)
            return;
        axis->tick_count = 0;
        low = pow(10, low);
        high = pow(10, high);
    }
    double decade = pow(10, floor(log10((high - low) / wanted))), step = 10 * decade;
    for (uint32_t i = 3; i-- > 0 && (high - low) / (decade * steps[i]) <= wanted;)
        step = decade * steps[i];
    for (double at = ceil(low / step - 1e-9); at * step <= high + 1e-9 * (high - low); at++)
        add_tick(axis, at * step);
}

static struct axis make_axis(const struct plot *plot, bool is_y, double begin, double end, uint32_t wanted)
{
    struct axis axis = {.is_log = is_y ? plot->is_log_y : plot->is_log_x, .begin = begin, .end = end};
    double low = is_y ? plot->y_minimum : plot->x_minimum, high = is_y ? plot->y_maximum : plot->x_maximum;
    axis.minimum = INFINITY;
    axis.maximum = -INFINITY;
    if (low < high && (!axis.is_log || low > 0)) {
        axis.minimum = axis_value(&axis, low);
        axis.maximum = axis_value(&axis, high);
    } else {
        for (uint32_t i = 0; i < plot->series_count; i++)
            for (uint32_t k = 0; k < plot->series[i].count; k++) {
                double value = axis_value(&axis, (is_y ? plot->series[i].y : plot->series[i].x)[k]);
                if (!isfinite(value))
                    continue;
                axis.minimum = fmin(axis.minimum, value);
                axis.maximum = fmax(axis.maximum, value);
            }
        if (!isfinite(axis.minimum))
            axis.minimum = axis.maximum = 0;
        if (is_y && plot->is_zero_based && !axis.is_log) {
            axis.minimum = fmin(axis.minimum, 0);
            axis.maximum = fmax(axis.maximum, 0);
        }
        double margin = 0.04 * (axis.maximum - axis.minimum);
        if (axis.minimum == axis.maximum)
            margin = axis.is_log ? 0.5 : axis.minimum == 0 ? 1 : fabs(axis.minimum) * 0.5;
        bool is_floor_zero = !axis.is_log && axis.minimum >= 0 && axis.minimum <= margin;
        axis.minimum = is_floor_zero ? 0 : axis.minimum - margin;
        axis.maximum += margin;
    }
    add_ticks(&axis, wanted);
    return axis;
}

/* ---- pieces -------------------------------------------------------------------------------------------- */

static void begin_svg(FILE *stream, double width, double height, const char *title)
{
    fprintf(stream,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"cp\" viewBox=\"0 0 %.0f %.0f\" width=\"%.0f\" "
            "height=\"%.0f\" role=\"img\"",
            width, height, width, height);
    if (title) {
        fputs(" aria-label=\"", stream);
        markup_text(stream, title);
        fputs("\"", stream);
    }
    fprintf(stream, ">%s", style_sheet);
}

static void write_label(FILE *stream, double x, double y, const char *anchor, const char *class_name,
                        const char *text)
{
    fprintf(stream, "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\" class=\"%s\">", x, y, anchor, class_name);
    markup_text(stream, text);
    fputs("</text>", stream);
}

/* Cut between characters where it is longer than a legend's line. */
static void write_legend_name(FILE *stream, double x, double y, const char *name)
{
    char text[4 * LEGEND_LETTERS + 8];
    size_t length = 0;
    uint32_t letters = 0;
    while (name[length] && length < 4 * LEGEND_LETTERS) {
        bool is_start = ((unsigned char)name[length] & 0xc0) != 0x80;
        if (is_start && letters == LEGEND_LETTERS)
            break;
        letters += is_start;
        length++;
    }
    memcpy(text, name, length);
    strcpy(text + length, name[length] ? "…" : "");
    write_label(stream, x, y, "start", "n", text);
}

static void write_mark(FILE *stream, uint32_t style, double x, double y)
{
    switch (style % 4) {
    case 0:
        fprintf(stream, "<circle class=\"m\" cx=\"%.1f\" cy=\"%.1f\" r=\"3.4\"", x, y);
        break;
    case 1:
        fprintf(stream, "<rect class=\"m\" x=\"%.1f\" y=\"%.1f\" width=\"6\" height=\"6\"", x - 3, y - 3);
        break;
    case 2:
        fprintf(stream, "<path class=\"m\" d=\"M%.1f %.1fl4 7h-8z\"", x, y - 4.5);
        break;
    default:
        fprintf(stream, "<path class=\"m\" d=\"M%.1f %.1fl4 4l-4 4l-4 -4z\"", x, y - 4);
    }
}

static uint32_t style_of(const struct plot *plot, uint32_t series)
{
    uint32_t style = plot->series[series].style;
    return style ? (style - 1) % STYLE_COUNT : series % STYLE_COUNT;
}

static void write_line(FILE *stream, const struct plot_series *series, uint32_t style, const struct axis *x,
                       const struct axis *y)
{
    fprintf(stream, "<path class=\"l\" stroke-dasharray=\"%s\" d=\"", dashes[style]);
    bool is_open = false;
    double before_y = 0;
    for (uint32_t k = 0; k < series->count; k++) {
        double px = axis_place(x, series->x[k]), py = axis_place(y, series->y[k]);
        bool is_drawn = isfinite(px) && isfinite(py);
        if (is_drawn && is_open && series->is_stepped)
            fprintf(stream, "L%.1f %.1f", px, before_y);
        if (is_drawn)
            fprintf(stream, "%c%.1f %.1f", is_open ? 'L' : 'M', px, py);
        is_open = is_drawn;
        before_y = py;
    }
    fputs("\"/>", stream);
}

static void write_marks(FILE *stream, const struct plot *plot, uint32_t index, uint32_t style,
                        const struct axis *x, const struct axis *y)
{
    const struct plot_series *series = &plot->series[index];
    for (uint32_t k = 0; k < series->count; k++) {
        double px = axis_place(x, series->x[k]), py = axis_place(y, series->y[k]);
        char x_text[32], y_text[32];
        if (!isfinite(px) || !isfinite(py))
            continue;
        plot_number(series->x[k], x_text, sizeof x_text);
        plot_number(series->y[k], y_text, sizeof y_text);
        write_mark(stream, style, px, py);
        fputs("><title>", stream);
        if (series->name) {
            markup_text(stream, series->name);
            fputs("\n", stream);
        }
        if (series->labels && series->labels[k]) {
            markup_text(stream, series->labels[k]);
            fputs("\n", stream);
        }
        markup_text(stream, plot->x_label ? plot->x_label : "x");
        fprintf(stream, ": %s\n", x_text);
        markup_text(stream, plot->y_label ? plot->y_label : "y");
        fprintf(stream, ": %s</title>", y_text);
        fputs(style % 4 == 0 ? "</circle>" : style % 4 == 1 ? "</rect>" : "</path>", stream);
    }
}

static void write_axes(FILE *stream, const struct plot *plot, const struct axis *x, const struct axis *y)
{
    char text[32];
    for (uint32_t i = 0; i < x->tick_count; i++) {
        double at = axis_place(x, x->ticks[i]);
        plot_number(x->ticks[i], text, sizeof text);
        fprintf(stream, "<path class=\"g\" d=\"M%.1f %.1fV%.1f\"/>", at, y->begin, y->end);
        write_label(stream, at, y->begin + 15, "middle", "n", text);
    }
    for (uint32_t i = 0; i < y->tick_count; i++) {
        double at = axis_place(y, y->ticks[i]);
        plot_number(y->ticks[i], text, sizeof text);
        fprintf(stream, "<path class=\"g\" d=\"M%.1f %.1fH%.1f\"/>", x->begin, at, x->end);
        write_label(stream, x->begin - 6, at + 4, "end", "n", text);
    }
    fprintf(stream, "<path class=\"x\" d=\"M%.1f %.1fV%.1fH%.1f\"/>", x->begin, y->end, y->begin, x->end);
    if (plot->x_label)
        write_label(stream, (x->begin + x->end) / 2, y->begin + 32, "middle", "n", plot->x_label);
    if (plot->y_label) {
        double middle = (y->begin + y->end) / 2;
        fprintf(stream, "<g transform=\"rotate(-90 14 %.1f)\">", middle);
        write_label(stream, 14, middle, "middle", "n", plot->y_label);
        fputs("</g>", stream);
    }
}

/* ---- plots --------------------------------------------------------------------------------------------- */

void plot_write(FILE *stream, const struct plot *plot)
{
    double width = plot->width ? plot->width : DEFAULT_WIDTH;
    double height = plot->height ? plot->height : DEFAULT_HEIGHT;
    size_t longest = 0;
    uint32_t named = 0;
    for (uint32_t i = 0; i < plot->series_count; i++) {
        if (!plot->series[i].name)
            continue;
        size_t length = strlen(plot->series[i].name);
        longest = length > longest ? length : longest;
        named++;
    }
    longest = longest < LEGEND_LETTERS ? longest : LEGEND_LETTERS + 1;
    double legend = named > 0 ? 40 + LETTER_WIDTH * (double)longest : 8;
    double needed = 60 + 16.0 * named;
    height = height > needed ? height : needed;
    double right = width - fmin(legend, width / 2), top = plot->title ? 30 : 12;
    struct axis x = make_axis(plot, false, 66, right - 8, 7);
    struct axis y = make_axis(plot, true, height - 44, top, 7);
    begin_svg(stream, width, height, plot->title);
    if (plot->title)
        write_label(stream, 66, 17, "start", "t", plot->title);
    write_axes(stream, plot, &x, &y);
    fprintf(stream,
            "<svg x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" height=\"%.1f\" viewBox=\"%.1f %.1f %.1f %.1f\">",
            x.begin - 6, y.end - 6, x.end - x.begin + 12, y.begin - y.end + 12, x.begin - 6, y.end - 6,
            x.end - x.begin + 12, y.begin - y.end + 12);
    for (uint32_t i = 0; i < plot->series_count; i++) {
        uint32_t style = style_of(plot, i);
        fprintf(stream, "<g class=\"s%u\">", style + 1);
        if (plot->series[i].has_line)
            write_line(stream, &plot->series[i], style, &x, &y);
        if (plot->series[i].has_marks)
            write_marks(stream, plot, i, style, &x, &y);
        fputs("</g>", stream);
    }
    fputs("</svg>", stream);
    double at = top + 4;
    for (uint32_t i = 0; i < plot->series_count; i++) {
        const struct plot_series *series = &plot->series[i];
        uint32_t style = style_of(plot, i);
        if (!series->name)
            continue;
        fprintf(stream, "<g class=\"s%u\">", style + 1);
        if (series->has_line)
            fprintf(stream, "<path class=\"l\" stroke-dasharray=\"%s\" d=\"M%.1f %.1fh22\"/>", dashes[style],
                    right, at);
        if (series->has_marks) {
            write_mark(stream, style, right + 11, at);
            fputs("/>", stream);
        }
        fputs("</g>", stream);
        write_legend_name(stream, right + 28, at + 4, series->name);
        at += 16;
    }
    fputs("</svg>\n", stream);
}

void plot_bars_write(FILE *stream, const struct plot_bars *bars)
{
    double width = bars->width ? bars->width : DEFAULT_WIDTH, largest = 0, label = 40;
    for (uint32_t row = 0; row < bars->row_count; row++) {
        double total = 0;
        for (uint32_t part = 0; part < bars->part_count; part++)
            total += fmax(bars->values[row * bars->part_count + part], 0);
        largest = fmax(largest, total);
        label = fmax(label, LETTER_WIDTH * (double)strlen(bars->rows[row]) + 12);
    }
    label = fmin(label, width / 3);
    double top = bars->title ? 30 : 10, legend = width - 8,
           legend_top = top + BAR_STEP * bars->row_count + 44;
    uint32_t columns = (uint32_t)fmax(1, floor((width - 16) / 120));
    double height = legend_top + 18 * ceil((double)bars->part_count / columns);
    struct plot scale = {.x_minimum = 0, .x_maximum = largest > 0 ? largest : 1};
    struct axis x = make_axis(&scale, false, label, legend - 8, 7);
    begin_svg(stream, width, height, bars->title);
    if (bars->title)
        write_label(stream, 8, 17, "start", "t", bars->title);
    double bottom = top + BAR_STEP * bars->row_count;
    for (uint32_t i = 0; i < x.tick_count; i++) {
        char text[32];
        plot_number(x.ticks[i], text, sizeof text);
        fprintf(stream, "<path class=\"g\" d=\"M%.1f %.1fV%.1f\"/>", axis_place(&x, x.ticks[i]), bottom, top);
        write_label(stream, axis_place(&x, x.ticks[i]), bottom + 14, "middle", "n", text);
    }
    if (bars->x_label)
        write_label(stream, (x.begin + x.end) / 2, bottom + 30, "middle", "n", bars->x_label);
    for (uint32_t row = 0; row < bars->row_count; row++) {
        double at = x.begin, y = top + BAR_STEP * row + (BAR_STEP - BAR_HEIGHT) / 2;
        write_label(stream, label - 6, y + 13, "end", "n", bars->rows[row]);
        for (uint32_t part = 0; part < bars->part_count; part++) {
            double value = fmax(bars->values[row * bars->part_count + part], 0);
            double size = value / x.maximum * (x.end - x.begin);
            char text[32];
            plot_number(value, text, sizeof text);
            /* Every second round of colours is paler: passes outnumber them. */
            fprintf(stream,
                    "<g class=\"s%u\"><rect class=\"b\" opacity=\"%s\" x=\"%.2f\" y=\"%.1f\" width=\"%.2f\" "
                    "height=\"%.0f\"><title>",
                    part % STYLE_COUNT + 1, part / STYLE_COUNT % 2 ? "0.45" : "1", at, y, size, BAR_HEIGHT);
            markup_text(stream, bars->rows[row]);
            fputs(", ", stream);
            markup_text(stream, bars->parts[part]);
            fprintf(stream, ": %s</title></rect></g>", text);
            at += size;
        }
    }
    for (uint32_t part = 0; part < bars->part_count; part++) {
        double left = 8 + 120.0 * (part % columns), y = legend_top + 18.0 * (part / columns);
        fprintf(stream,
                "<g class=\"s%u\"><rect class=\"b\" opacity=\"%s\" x=\"%.1f\" y=\"%.1f\" width=\"10\" "
                "height=\"10\"/></g>",
                part % STYLE_COUNT + 1, part / STYLE_COUNT % 2 ? "0.45" : "1", left, y - 9);
        write_legend_name(stream, left + 14, y, bars->parts[part]);
    }
    fputs("</svg>\n", stream);
}

bool plot_write_file(const char *path, const struct plot *plot, struct error *error)
{
    struct markup_file file;
    if (!markup_open(&file, path, error))
        return false;
    plot_write(file.stream, plot);
    return markup_close(&file, error);
}

bool plot_bars_write_file(const char *path, const struct plot_bars *bars, struct error *error)
{
    struct markup_file file;
    if (!markup_open(&file, path, error))
        return false;
    plot_bars_write(file.stream, bars);
    return markup_close(&file, error);
}
