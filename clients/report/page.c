#define _GNU_SOURCE
#include "page.h"

#include <errno.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "../../core/image/image_io.h"
#include "markup.h"

struct page {
    FILE *stream; /* into `text` */
    char *text;
    size_t size;
    uint32_t column, column_count;
    uint64_t is_number; /* bit i: column i holds numbers; of the first 64 */
    enum page_tone tone;
    struct error error; /* the first that happened; STATUS_OK: none */
};

static const char head[] =
    "<!DOCTYPE html>\n<html lang=\"en\" xmlns=\"http://www.w3.org/1999/xhtml\"><head><meta "
    "charset=\"utf-8\"/>"
    "<meta name=\"viewport\" content=\"width=device-width,initial-scale=1\"/>\n<style>\n"
    ":root{--paper:#fff;--ink:#222;--faint:#666;--rule:#ddd;--band:#f6f6f4;--good:#dff3e4;--bad:#fbe0da}\n"
    "@media screen and (prefers-color-scheme:dark){:root{--paper:#161616;--ink:#ddd;--faint:#999;"
    "--rule:#383838;--band:#202020;--good:#173a24;--bad:#4a1f17}}\n"
    "body{background:var(--paper);color:var(--ink);font:15px/1.5 system-ui,sans-serif;margin:2em auto;"
    "max-width:70em;padding:0 1.5em}\n"
    "h1{font-size:1.6em;margin:0}h2{font-size:1.2em;margin:2em 0 .4em;border-bottom:1px solid var(--rule)}"
    "h3{font-size:1em;margin:1.4em 0 .3em}\n"
    ".sub,figcaption,.facts{color:var(--faint)}.facts span{margin-right:1.6em}.facts b{font-weight:600}\n"
    "p{max-width:48em}table{border-collapse:collapse;font-size:.86em;margin:.8em 0}\n"
    "th,td{padding:.2em .7em;text-align:left;border-bottom:1px solid var(--rule);vertical-align:top}"
    "th{background:var(--band)}td.n,th.n{text-align:right;white-space:nowrap;font-variant-numeric:tabular-"
    "nums}\n"
    ".scroll{overflow-x:auto}svg{max-width:100%;height:auto}\n"
    "td.good{background:var(--good)}td.bad{background:var(--bad)}.warning{background:var(--bad);padding:.5em "
    "1em}\n"
    "figure{margin:.8em 0}.row{display:flex;flex-wrap:wrap;gap:1em}.row figure{flex:0 1 auto;margin:0}\n"
    "img{max-width:100%;height:auto;display:block;image-rendering:pixelated;background:#000}\n"
    ".slider{position:relative;display:inline-block;max-width:100%}"
    ".slider .after{position:absolute;inset:0;clip-path:inset(0 0 0 50%)}"
    ".slider input{width:100%;margin:.4em 0 "
    "0}.slider+figcaption{display:flex;justify-content:space-between}\n"
    ".slider .frame{position:relative}summary{cursor:pointer}\n"
    "@media print{body{margin:0;max-width:none;font-size:11px}h2,h3{break-after:avoid}"
    "figure,svg,tr{break-inside:avoid}.slider input{display:none}}\n"
    "</style>\n";

static const char tail[] =
    "<script>\n//<![CDATA[\n"
    "document.querySelectorAll('.slider').forEach(function(s){var i=s.querySelector('input'),"
    "a=s.querySelector('.after');i.addEventListener('input',function(){"
    "a.style.clipPath='inset(0 0 0 '+i.value+'%)';});});\n"
    "//]]>\n</script>\n</body></html>\n";

static void keep_error(struct page *page, const struct error *error)
{
    if (page->error.status == STATUS_OK)
        page->error = *error;
}

static void write_element(struct page *page, const char *name, const char *text)
{
    fprintf(page->stream, "<%s>", name);
    markup_text(page->stream, text);
    fprintf(page->stream, "</%.*s>\n", (int)strcspn(name, " "), name);
}

/* Formats and escapes. */
static void write_formatted(struct page *page, const char *format, va_list arguments)
{
    char *text = NULL;
    if (vasprintf(&text, format, arguments) < 0)
        keep_error(page, &(struct error){STATUS_MEMORY, "no memory for a text"});
    else
        markup_text(page->stream, text);
    free(text);
}

struct page *page_create(const char *title, const char *subtitle, struct error *error)
{
    struct page *page = calloc(1, sizeof *page);
    if (page)
        page->stream = open_memstream(&page->text, &page->size);
    if (!page || !page->stream) {
        free(page);
        error_set(error, STATUS_MEMORY, "no memory for a report");
        return NULL;
    }
    fputs(head, page->stream);
    write_element(page, "title", title);
    fputs("</head><body>\n", page->stream);
    write_element(page, "h1", title);
    if (subtitle)
        write_element(page, "p class=\"sub\"", subtitle);
    return page;
}

void page_destroy(struct page **page)
{
    if (*page) {
        fclose((*page)->stream);
        free((*page)->text);
        free(*page);
    }
    *page = NULL;
}

bool page_write(struct page *page, const char *path, struct error *error)
{
    struct markup_file file;
    if (fflush(page->stream) != 0)
        keep_error(page, &(struct error){STATUS_MEMORY, "no memory for the report"});
    if (page->error.status != STATUS_OK) {
        *error = page->error;
        return false;
    }
    if (!markup_open(&file, path, error))
        return false;
    fwrite(page->text, 1, page->size, file.stream);
    fputs(tail, file.stream);
    return markup_close(&file, error);
}

/* ---- text ---------------------------------------------------------------------------------------------- */

void page_facts(struct page *page, const struct page_fact *facts, uint32_t count)
{
    fputs("<p class=\"facts\">", page->stream);
    for (uint32_t i = 0; i < count; i++) {
        fputs("<span>", page->stream);
        markup_text(page->stream, facts[i].name);
        fputs(" <b>", page->stream);
        markup_text(page->stream, facts[i].value);
        fputs("</b></span> ", page->stream);
    }
    fputs("</p>\n", page->stream);
}

void page_heading(struct page *page, const char *text)
{
    write_element(page, "h2", text);
}

void page_subheading(struct page *page, const char *text)
{
    write_element(page, "h3", text);
}

void page_paragraph(struct page *page, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    fputs("<p>", page->stream);
    write_formatted(page, format, arguments);
    fputs("</p>\n", page->stream);
    va_end(arguments);
}

void page_warning(struct page *page, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    fputs("<p class=\"warning\">", page->stream);
    write_formatted(page, format, arguments);
    fputs("</p>\n", page->stream);
    va_end(arguments);
}

void page_details_begin(struct page *page, const char *summary)
{
    fputs("<details>", page->stream);
    write_element(page, "summary", summary);
}

void page_details_end(struct page *page)
{
    fputs("</details>\n", page->stream);
}

/* ---- tables -------------------------------------------------------------------------------------------- */

static bool is_number_column(const struct page *page, uint32_t column)
{
    return column < 64 && (page->is_number >> column & 1) != 0;
}

void page_table_begin(struct page *page, const char *const *columns, uint32_t count)
{
    page->column_count = count;
    page->column = 0;
    page->is_number = 0;
    fputs("<div class=\"scroll\"><table><thead><tr>", page->stream);
    for (uint32_t i = 0; i < count; i++) {
        bool is_number = columns[i][0] == '#';
        if (is_number && i < 64)
            page->is_number |= 1ull << i;
        fputs(is_number ? "<th class=\"n\">" : "<th>", page->stream);
        markup_text(page->stream, columns[i] + is_number);
        fputs("</th>", page->stream);
    }
    fputs("</tr></thead><tbody>\n", page->stream);
}

static void begin_cell(struct page *page)
{
    static const char *const tones[] = {"", " good", " bad"};
    if (page->column == 0)
        fputs("<tr>", page->stream);
    fprintf(page->stream, "<td class=\"%s%s\">", is_number_column(page, page->column) ? "n" : "c",
            tones[page->tone]);
    page->tone = PAGE_NEUTRAL;
}

static void end_cell(struct page *page)
{
    fputs("</td>", page->stream);
    page->column = (page->column + 1) % page->column_count;
    if (page->column == 0)
        fputs("</tr>\n", page->stream);
}

void page_cell(struct page *page, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    begin_cell(page);
    write_formatted(page, format, arguments);
    end_cell(page);
    va_end(arguments);
}

void page_cell_number(struct page *page, double value)
{
    char text[32];
    plot_number(value, text, sizeof text);
    page_cell(page, "%s", text);
}

void page_next_tone(struct page *page, enum page_tone tone)
{
    page->tone = tone;
}

void page_table_end(struct page *page)
{
    if (page->column != 0)
        fputs("</tr>", page->stream);
    fputs("</tbody></table></div>\n", page->stream);
}

/* ---- plots and pictures -------------------------------------------------------------------------------- */

void page_plot(struct page *page, const struct plot *plot)
{
    fputs("<figure>", page->stream);
    plot_write(page->stream, plot);
    fputs("</figure>\n", page->stream);
}

void page_bars(struct page *page, const struct plot_bars *bars)
{
    fputs("<figure>", page->stream);
    plot_bars_write(page->stream, bars);
    fputs("</figure>\n", page->stream);
}

/* As <img> with the PNG inside. The encoder writes files only, so it goes through one. */
static void write_image(struct page *page, const struct page_picture *picture, const char *class_name)
{
    struct error error;
    char folder[] = "/tmp/caustic-report-XXXXXX", path[64];
    if (!mkdtemp(folder)) {
        error_set(&error, STATUS_IO, "%s: %s", folder, strerror(errno));
        keep_error(page, &error);
        return;
    }
    snprintf(path, sizeof path, "%s/picture.png", folder);
    uint8_t *bytes = NULL;
    size_t size = 0;
    if (!image_write_png(path, picture->width, picture->height, 3, picture->pixels, &error)) {
        keep_error(page, &error);
    } else {
        FILE *file = fopen(path, "rb");
        struct stat status;
        if (file && fstat(fileno(file), &status) == 0 && status.st_size > 0)
            bytes = malloc((size_t)status.st_size);
        if (bytes)
            size = fread(bytes, 1, (size_t)status.st_size, file);
        if (file)
            fclose(file);
        if (size == 0)
            keep_error(page, &(struct error){STATUS_IO, "a picture of the report could not be read back"});
    }
    unlink(path);
    rmdir(folder);
    fprintf(page->stream, "<img class=\"%s\" width=\"%u\" height=\"%u\" alt=\"", class_name, picture->width,
            picture->height);
    markup_text(page->stream, picture->caption);
    fputs("\" src=\"data:image/png;base64,", page->stream);
    markup_base64(page->stream, bytes, size);
    fputs("\"/>", page->stream);
    free(bytes);
}

void page_row_begin(struct page *page)
{
    fputs("<div class=\"row\">", page->stream);
}

void page_row_end(struct page *page)
{
    fputs("</div>\n", page->stream);
}

void page_pictures(struct page *page, const struct page_picture *pictures, uint32_t count)
{
    page_row_begin(page);
    for (uint32_t i = 0; i < count; i++) {
        fputs("<figure>", page->stream);
        write_image(page, &pictures[i], "plain");
        write_element(page, "figcaption", pictures[i].caption);
        fputs("</figure>", page->stream);
    }
    page_row_end(page);
}

void page_slider(struct page *page, const struct page_picture *before, const struct page_picture *after)
{
    fputs("<figure><div class=\"slider\"><div class=\"frame\">", page->stream);
    write_image(page, before, "before");
    write_image(page, after, "after");
    fputs("</div><input type=\"range\" min=\"0\" max=\"100\" value=\"50\" aria-label=\"edge between the "
          "pictures\"/></div><figcaption><span>",
          page->stream);
    markup_text(page->stream, before->caption);
    fputs(" | ", page->stream);
    markup_text(page->stream, after->caption);
    fputs("</span></figcaption></figure>\n", page->stream);
}
