/* page.h: one self-contained HTML page: text, tables, plots, pictures, and a slider between two pictures.
 *
 *     struct page *page = page_create("caustic-bench", "sphere at 480x270", &error);
 *     page_facts(page, facts, 3);
 *     page_heading(page, "Error against time");
 *     page_plot(page, &plot);
 *     bool is_written = page_write(page, "out/report.html", &error);
 *     page_destroy(&page);
 *
 * Nothing is fetched: style, script, SVG and PNG are inside. It is valid XHTML syntax as well, follows the
 * reader's light or dark mode, and prints in light. Every text is escaped. A page that could not be kept in
 * memory, or a picture that could not be encoded, is told by page_write. Threads: one at a time per page.
 */
#ifndef CAUSTIC_PAGE_H
#define CAUSTIC_PAGE_H

#include "plot.h"

struct page;

struct page *page_create(const char *title, const char *subtitle, struct error *error);
void page_destroy(struct page **page);
bool page_write(struct page *page, const char *path, struct error *error);

/* A line of names and values under the title: device, version, scene. */
struct page_fact {
    const char *name, *value;
};
void page_facts(struct page *page, const struct page_fact *facts, uint32_t count);

void page_heading(struct page *page, const char *text);    /* of a section */
void page_subheading(struct page *page, const char *text); /* within one */
void page_paragraph(struct page *page, const char *format, ...) __attribute__((format(printf, 2, 3)));
/* What went wrong or passed a threshold, in a frame of its own. */
void page_warning(struct page *page, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* A table row by row: page_table_begin with the column titles, cells in order, page_table_end. A column whose
 * title begins with '#' holds numbers: set to the right, its title without the '#'. */
void page_table_begin(struct page *page, const char *const *columns, uint32_t count);
void page_cell(struct page *page, const char *format, ...) __attribute__((format(printf, 2, 3)));
void page_cell_number(struct page *page, double value); /* as plot_number */
/* Good, bad: colours the next cell. */
enum page_tone { PAGE_NEUTRAL, PAGE_GOOD, PAGE_BAD };
void page_next_tone(struct page *page, enum page_tone tone);
void page_table_end(struct page *page);

void page_plot(struct page *page, const struct plot *plot);
void page_bars(struct page *page, const struct plot_bars *bars);

/* 8-bit sRGB, 3 components, rows from the top. */
struct page_picture {
    const char *caption;
    const uint8_t *pixels;
    uint32_t width, height;
};
void page_pictures(struct page *page, const struct page_picture *pictures, uint32_t count); /* in a row */
/* Two pictures of one size over each other; a slider moves the edge between them. */
void page_slider(struct page *page, const struct page_picture *before, const struct page_picture *after);

/* What comes between stands side by side where there is room. */
void page_row_begin(struct page *page);
void page_row_end(struct page *page);

/* A part that is closed until it is clicked. */
void page_details_begin(struct page *page, const char *summary);
void page_details_end(struct page *page);

#endif
