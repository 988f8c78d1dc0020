#include "report_page.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../../core/image/image_io.h"
#include "../report/page.h"
#include "measures.h"

#define MAX_POINTS   800u /* of a line: more are drawn by the lowest and highest of each stretch */
#define MAX_PATHS    16u
#define MAX_PICTURES 8u

static const char *text_of(json_t *object, const char *name)
{
    const char *text = json_string_value(json_object_get(object, name));
    return text ? text : "";
}

static double number_of(json_t *object, const char *name)
{
    return json_number_value(json_object_get(object, name));
}

/* ---- plots --------------------------------------------------------------------------------------------- */

/* Series that share a plot: those of `names` a path has. */
static const struct plot_group {
    const char *title, *y_label, *names[4];
    bool is_log;
} plot_groups[] = {
    {"What is still to be made of the change", "share", {"remaining", "ghost"}, true},
    {"Error against the reference", "relative L1", {"error"}, false},
    {"FLIP", "FLIP", {"flip"}, false},
    {"Difference from the frame before", "RMS, share", {"successive"}, false},
    {"Photons emitted", "photons", {"photons"}, false},
    {"Density of all cells, before the budget's scale", "photons", {"density"}, true},
    {"Density of the densest cell", "photons", {"densest"}, true},
    {"Light of the picture", "mean luminance", {"light"}, false},
};

struct line {
    double *x, *y;
    uint32_t count;
};

static void add_point(struct line *line, json_t *values, size_t at, double first)
{
    line->x[line->count] = first + (double)at;
    line->y[line->count++] = json_number_value(json_array_get(values, at));
}

/* What is no number is left out. Of a long series the lowest and the highest value of every stretch are
 * drawn: to take every n-th frame would hide what swings. */
static bool read_line(json_t *series, struct line *line)
{
    json_t *values = json_object_get(series, "values"), *value;
    size_t count = json_array_size(values), stretch = count / (MAX_POINTS / 2) + 1;
    double first = number_of(series, "first");
    *line = (struct line){malloc((count + 1) * sizeof(double)), malloc((count + 1) * sizeof(double)), 0};
    if (!line->x || !line->y)
        return false;
    for (size_t begin = 0; begin < count; begin += stretch) {
        size_t low = count, high = count;
        for (size_t i = begin; i < begin + stretch && i < count; i++) {
            value = json_array_get(values, i);
            if (!json_is_number(value))
                continue;
            if (low == count || json_number_value(value) < json_number_value(json_array_get(values, low)))
                low = i;
            if (high == count || json_number_value(value) > json_number_value(json_array_get(values, high)))
                high = i;
        }
        if (low == count)
            continue;
        add_point(line, values, low < high ? low : high, first);
        if (low != high)
            add_point(line, values, low < high ? high : low, first);
    }
    return true;
}

static void draw_group(struct page *page, json_t *path, const struct plot_group *group)
{
    struct plot_series drawn[4];
    struct line lines[4];
    uint32_t count = 0;
    for (uint32_t i = 0; i < 4 && group->names[i]; i++) {
        size_t k;
        json_t *series;
        json_array_foreach(json_object_get(path, "series"), k, series)
        {
            if (strcmp(text_of(series, "name"), group->names[i]) != 0)
                continue;
            if (read_line(series, &lines[count]) && lines[count].count > 0) {
                drawn[count] = (struct plot_series){.name = group->names[1] ? text_of(series, "name") : NULL,
                                                    .x = lines[count].x,
                                                    .y = lines[count].y,
                                                    .count = lines[count].count,
                                                    .has_line = true,
                                                    .has_marks = lines[count].count <= 100};
                count++;
            } else {
                free(lines[count].x);
                free(lines[count].y);
            }
            break;
        }
    }
    if (count > 0)
        page_plot(page, &(struct plot){.title = group->title,
                                       .x_label = "frame",
                                       .y_label = group->y_label,
                                       .is_log_y = group->is_log,
                                       .width = 760,
                                       .height = 260,
                                       .series = drawn,
                                       .series_count = count});
    for (uint32_t i = 0; i < count; i++) {
        free(lines[i].x);
        free(lines[i].y);
    }
}

/* ---- pictures ------------------------------------------------------------------------------------------ */

/* The bytes of an 8-bit PNG; NULL when it is not there any more. */
static uint8_t *read_png(const char *path, uint32_t *width, uint32_t *height)
{
    struct image_texels texels;
    struct error ignored; /* a picture that is gone is left out */
    uint8_t *pixels = NULL;
    FILE *file = fopen(path, "rb");
    long size = file && fseek(file, 0, SEEK_END) == 0 ? ftell(file) : 0;
    void *bytes = size > 0 ? malloc((size_t)size) : NULL;
    if (bytes && fseek(file, 0, SEEK_SET) == 0 && fread(bytes, 1, (size_t)size, file) == (size_t)size &&
        image_decode(bytes, (size_t)size, &(struct image_decode_params){.name = path}, &texels, &ignored)) {
        size_t count = (size_t)texels.width * texels.height;
        pixels = malloc(count * 3);
        for (size_t i = 0; pixels && i < count * 3; i++)
            pixels[i] = (uint8_t)(255 * image_half_to_float(texels.texels[i / 3 * 4 + i % 3]) + 0.5f);
        *width = texels.width;
        *height = texels.height;
        free(texels.texels);
    }
    free(bytes);
    if (file)
        fclose(file);
    return pixels;
}

static void show_pictures(struct page *page, json_t *path, const char *folder)
{
    struct page_picture pictures[MAX_PICTURES];
    uint8_t *pixels[MAX_PICTURES];
    uint32_t count = 0;
    size_t i;
    json_t *picture;
    json_array_foreach(json_object_get(path, "pictures"), i, picture)
    {
        char name[4300];
        struct page_picture *shown = &pictures[count];
        snprintf(name, sizeof name, "%s/%s", folder, text_of(picture, "file"));
        if (count == MAX_PICTURES || strchr(text_of(picture, "file"), '/') ||
            !(pixels[count] = read_png(name, &shown->width, &shown->height)))
            continue;
        shown->caption = text_of(picture, "caption");
        shown->pixels = pixels[count++];
    }
    if (count > 0)
        page_pictures(page, pictures, count);
    for (uint32_t k = 0; k < count; k++)
        free(pixels[k]);
}

/* ---- tables -------------------------------------------------------------------------------------------- */

static void show_limits(struct page *page, json_t *limits)
{
    static const char *const columns[] = {"limit of", "path", "#value", "#limit", ""};
    size_t i;
    json_t *limit;
    if (json_array_size(limits) == 0)
        return;
    page_heading(page, "Limits");
    page_table_begin(page, columns, 5);
    json_array_foreach(limits, i, limit)
    {
        char value[40];
        bool passed = json_is_true(json_object_get(limit, "passed"));
        measure_print(json_object_get(limit, "value"), value, sizeof value);
        page_cell(page, "%s", text_of(limit, "measure"));
        page_cell(page, "%s", text_of(limit, "path"));
        page_cell(page, "%s", value);
        page_cell_number(page, number_of(limit, "limit"));
        page_next_tone(page, passed ? PAGE_GOOD : PAGE_BAD);
        page_cell(page, "%s", passed ? "within" : "above");
    }
    page_table_end(page);
}

static void show_measures(struct page *page, json_t *root)
{
    json_t *paths = json_object_get(root, "paths"), *path;
    const char *columns[MAX_PATHS + 3] = {"measure", "unit"};
    char titles[MAX_PATHS][40];
    uint32_t count = 0;
    size_t i;
    json_array_foreach(paths, i, path)
    {
        if (count == MAX_PATHS)
            break;
        snprintf(titles[count], sizeof titles[count], "#%.38s", text_of(path, "path"));
        columns[2 + count] = titles[count];
        count++;
    }
    columns[2 + count] = "what it is";
    page_heading(page, "Every measure");
    page_table_begin(page, columns, count + 3);
    for (int m = 0; m < MEASURE_COUNT; m++) {
        const struct measure_info *info = &measure_infos[m];
        bool is_measured = false;
        json_array_foreach(paths, i, path) is_measured |=
            json_object_get(json_object_get(path, "measures"), info->name) != NULL;
        if (!is_measured)
            continue;
        page_cell(page, "%s", info->name);
        page_cell(page, "%s", info->unit);
        for (i = 0; i < count; i++) {
            char text[40] = "";
            json_t *value =
                json_object_get(json_object_get(json_array_get(paths, i), "measures"), info->name);
            if (value)
                measure_print(value, text, sizeof text);
            page_cell(page, "%s", text);
        }
        page_cell(page, "%s", info->help);
    }
    page_table_end(page);
    page_paragraph(page,
                   "A share of 0.01 is 1 %%. \"never\": not within this run. \"-\": cannot be told, as the "
                   "period of what does not swing.");
}

static void show_path(struct page *page, json_t *path, const char *folder)
{
    json_t *cost = json_object_get(path, "cost");
    page_heading(page, text_of(path, "path"));
    page_paragraph(page, "%s; %.0f frames after a warm-up of %.0f.", text_of(path, "what"),
                   number_of(path, "frames"), number_of(path, "warmup"));
    if (!json_is_true(json_object_get(path, "is_complete")))
        page_warning(page, "Cut short: %s", text_of(path, "reason"));
    if (number_of(cost, "references") > 0)
        page_paragraph(page,
                       "A frame took %.3g s from request to last byte. %.0f references took %.3g s each: "
                       "%.3g frames' time.",
                       number_of(cost, "frame_seconds"), number_of(cost, "references"),
                       number_of(cost, "reference_seconds"), number_of(cost, "reference_frames"));
    show_pictures(page, path, folder);
    for (size_t i = 0; i < sizeof plot_groups / sizeof *plot_groups; i++)
        draw_group(page, path, &plot_groups[i]);
}

bool report_page_write(json_t *root, const char *folder, const char *path, struct error *error)
{
    json_t *run = json_object_get(root, "run"), *server = json_object_get(run, "server"),
           *view = json_object_get(run, "view"), *settings = json_object_get(run, "settings"), *value;
    char size[60], subtitle[200], changed[400] = "defaults";
    const char *name;
    size_t used = 0, i;
    snprintf(size, sizeof size, "%.0fx%.0f", number_of(view, "width"), number_of(view, "height"));
    snprintf(subtitle, sizeof subtitle, "%.100s at %s, channel %.40s",
             text_of(json_object_get(run, "scene"), "name"), size, text_of(view, "channel"));
    json_object_foreach(settings, name, value)
    {
        if (used < sizeof changed - 1)
            used += (size_t)snprintf(changed + used, sizeof changed - used, "%s%s=%s", used ? ", " : "", name,
                                     json_string_value(value));
    }
    struct page *page = page_create("caustic-stability", subtitle, error);
    if (!page)
        return false;
    const struct page_fact facts[] = {{"device", text_of(server, "device")},
                                      {"driver", text_of(server, "driver")},
                                      {"tracer", text_of(server, "tracer")},
                                      {"server", text_of(server, "version")},
                                      {"settings", changed}};
    page_facts(page, facts, sizeof facts / sizeof *facts);
    show_limits(page, json_object_get(root, "limits"));
    show_measures(page, root);
    json_array_foreach(json_object_get(root, "paths"), i, value) show_path(page, value, folder);
    bool is_written = page_write(page, path, error);
    page_destroy(&page);
    return is_written;
}
