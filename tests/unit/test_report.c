/* The report library: pages and plots are well formed whatever is put into them, points lie where the axes
 * say, pictures come back out as they went in. */
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "clients/report/page.h"
#include "core/image/image_io.h"
#include "tests/support/check.h"

static struct error error;
static char folder[] = "/tmp/test_report_XXXXXX", path[96];

static char *read_text(const char *file)
{
    FILE *stream = fopen(file, "rb");
    assert_non_null(stream);
    char *text = calloc(1, 1u << 20);
    assert_non_null(text);
    size_t size = fread(text, 1, (1u << 20) - 1, stream);
    fclose(stream);
    assert_true(size < (1u << 20) - 1);
    return text;
}

/* Every element is closed in its order, no text has a bare < or &. Returns the number of elements. */
static uint32_t check_elements(const char *text)
{
    char open[64][32];
    uint32_t depth = 0, count = 0;
    const char *at = text;
    if (strncmp(at, "<!DOCTYPE html>", 15) == 0)
        at += 15;
    while (*at) {
        if (*at == '&') {
            const char *end = strchr(at, ';');
            assert_true(end && end - at <= 6);
        }
        if (*at != '<') {
            at++;
            continue;
        }
        size_t length = strcspn(at + 1, " />\n") + 1;
        const char *end = strchr(at, '>');
        assert_non_null(end);
        assert_true(strcspn(at + 1, "<") > (size_t)(end - at - 1));
        if (at[1] == '/') {
            assert_true(depth > 0);
            depth--;
            size_t name = (size_t)(end - at - 2);
            if (strlen(open[depth]) != name || strncmp(open[depth], at + 2, name) != 0)
                fail_msg("<%s> is closed by %.*s", open[depth], (int)(end - at + 1), at);
        } else {
            count++;
            if (end[-1] != '/') {
                assert_true(depth < 64 && length < 32);
                snprintf(open[depth++], 32, "%.*s", (int)(length - 1), at + 1);
                if (strcmp(open[depth - 1], "script") == 0)
                    end = strstr(at, "</script>") - 1;
            }
        }
        at = end + 1;
    }
    assert_int_equal(depth, 0);
    return count;
}

static uint32_t count_of(const char *text, const char *part)
{
    uint32_t count = 0;
    for (const char *at = strstr(text, part); at; at = strstr(at + 1, part))
        count++;
    return count;
}

/* Undoes base64. */
static size_t decode_base64(const char *text, uint8_t *bytes)
{
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    size_t size = 0;
    uint32_t group = 0, bits = 0;
    for (; *text && strchr(digits, *text); text++) {
        group = group << 6 | (uint32_t)(strchr(digits, *text) - digits);
        bits += 6;
        if (bits >= 8) {
            bits -= 8;
            bytes[size++] = (uint8_t)(group >> bits);
        }
    }
    return size;
}

static void a_page_is_well_formed(void **state)
{
    (void)state;
    static const char nasty[] = "<script>alert(\"&'\\\x01\")</script> für ½";
    struct page *page = page_create(nasty, nasty, &error);
    assert_non_null(page);
    page_facts(page, (struct page_fact[]){{"device", nasty}, {nasty, "1"}}, 2);
    page_heading(page, nasty);
    page_subheading(page, nasty);
    page_paragraph(page, "%s, %d %%", nasty, 3);
    page_warning(page, "%s", nasty);
    page_table_begin(page, (const char *const[]){"name", "#value", nasty}, 3);
    for (uint32_t i = 0; i < 2; i++) {
        page_cell(page, "%s", nasty);
        page_next_tone(page, PAGE_BAD);
        page_cell_number(page, 0.25);
        page_cell(page, "last");
    }
    page_cell(page, "a row that is cut short");
    page_table_end(page);
    page_details_begin(page, nasty);
    const double xs[] = {1, 10, 100}, ys[] = {1, 0, 3};
    const char *const labels[] = {nasty, NULL, "third"};
    struct plot_series series = {
        .name = nasty, .x = xs, .y = ys, .count = 3, .labels = labels, .has_line = true, .has_marks = true};
    page_plot(page,
              &(struct plot){
                  .title = nasty, .x_label = nasty, .y_label = nasty, .series = &series, .series_count = 1});
    page_bars(page, &(struct plot_bars){.title = nasty,
                                        .rows = (const char *const[]){nasty},
                                        .parts = (const char *const[]){nasty, "b"},
                                        .row_count = 1,
                                        .part_count = 2,
                                        .values = xs});
    page_details_end(page);
    assert_true(page_write(page, path, &error));
    page_destroy(&page);
    assert_null(page);
    char *text = read_text(path);
    assert_true(check_elements(text) > 60);
    /* The only script is the page's own; nothing is fetched. */
    assert_int_equal(count_of(text, "<script"), 1);
    assert_int_equal(count_of(text, "alert("), count_of(text, "alert(&quot;&amp;"));
    assert_int_equal(count_of(text, "http"), count_of(text, "=\"http://www.w3.org/"));
    assert_int_equal(count_of(text, "<td class=\"n bad\">0.25</td>"), 2);
    /* Legends cut long names, the plot's and the bars'. */
    assert_int_equal(count_of(text, "für ½"), count_of(text, "alert(") - 2);
    free(text);
}

static void pictures_are_inside(void **state)
{
    (void)state;
    uint8_t pixels[3 * 5 * 3];
    for (uint32_t i = 0; i < sizeof pixels; i++)
        pixels[i] = (uint8_t)(17 * i);
    struct page *page = page_create("pictures", NULL, &error);
    const struct page_picture picture = {.caption = "a <b>", .pixels = pixels, .width = 5, .height = 3};
    page_pictures(page, &picture, 1);
    page_slider(page, &picture, &picture);
    if (!page_write(page, path, &error)) {
        assert_int_equal(error.status, STATUS_UNSUPPORTED); /* a build without images says so */
        page_destroy(&page);
        return;
    }
    page_destroy(&page);
    char *text = read_text(path);
    check_elements(text);
    static const char begin[] = "src=\"data:image/png;base64,";
    assert_int_equal(count_of(text, begin), 3);
    assert_int_equal(count_of(text, "src="), 3);
    uint8_t bytes[4096];
    size_t size = decode_base64(strstr(text, begin) + sizeof begin - 1, bytes);
    struct image_texels texels;
    assert_true(image_decode(bytes, size, &(struct image_decode_params){.is_srgb = false}, &texels, &error));
    assert_int_equal(texels.width, 5);
    assert_int_equal(texels.height, 3);
    for (uint32_t i = 0; i < 15; i++)
        for (uint32_t c = 0; c < 3; c++)
            assert_close((double)image_half_to_float(texels.texels[i * 4 + c]), pixels[i * 3 + c] / 255.0,
                         5e-4);
    free(texels.texels);
    free(text);
}

/* The x of the point whose tooltip ends in `y_text`, drawn as a circle. */
static double circle_x(const char *text, const char *tooltip_end)
{
    const char *at = strstr(text, tooltip_end);
    assert_non_null(at);
    while (at > text && strncmp(at, "cx=\"", 4) != 0)
        at--;
    return strtod(at + 4, NULL);
}

static void points_lie_where_the_axes_say(void **state)
{
    (void)state;
    const double xs[] = {1, 10, 100, 1000, -5}, ys[] = {1, 2, 3, 4, 5};
    struct plot_series series = {.x = xs, .y = ys, .count = 5, .has_line = true, .has_marks = true};
    struct plot plot = {.is_log_x = true, .series = &series, .series_count = 1, .y_label = "y"};
    char svg[64];
    snprintf(svg, sizeof svg, "%s/plot.svg", folder);
    assert_true(plot_write_file(svg, &plot, &error));
    char *text = read_text(svg);
    check_elements(text);
    /* Decades are equally far apart; what a log axis cannot show is not there. */
    double first = circle_x(text, "y: 1<"), step = circle_x(text, "y: 2<") - first;
    assert_true(step > 50);
    assert_close(circle_x(text, "y: 3<"), first + 2 * step, 0.11);
    assert_close(circle_x(text, "y: 4<"), first + 3 * step, 0.11);
    assert_null(strstr(text, "y: 5<"));
    free(text);
    plot.is_log_x = false;
    series.count = 4;
    assert_true(plot_write_file(svg, &plot, &error));
    text = read_text(svg);
    first = circle_x(text, "y: 1<");
    step = (circle_x(text, "y: 4<") - first) / 999;
    assert_close(circle_x(text, "y: 3<"), first + 99 * step, 0.11);
    free(text);
    unlink(svg);
}

/* Every number and label of an axis is distinct, and there are some, whatever the range. */
static void axes_have_ticks(void **state)
{
    (void)state;
    const double ranges[][2] = {{0, 1}, {0.2, 0.21}, {-3, 5},  {1e-7, 1e-6}, {5, 5},
                                {0, 0}, {1, 1e9},    {30, 40}, {-2e8, -1e8}, {999, 1001}};
    for (size_t i = 0; i < sizeof ranges / sizeof *ranges; i++)
        for (int is_log = 0; is_log < 2; is_log++) {
            struct plot_series series = {.x = ranges[i], .y = ranges[i], .count = 2, .has_line = true};
            struct plot plot = {.is_log_x = is_log, .is_log_y = is_log, .series = &series, .series_count = 1};
            char *text = NULL;
            size_t size = 0;
            FILE *stream = open_memstream(&text, &size);
            plot_write(stream, &plot);
            fclose(stream);
            check_elements(text);
            uint32_t ticks = count_of(text, "class=\"g\"");
            if (ticks < 4 || ticks > 40)
                fail_msg("%g to %g%s: %u ticks", ranges[i][0], ranges[i][1], is_log ? ", log" : "", ticks);
            assert_null(strstr(text, "nan"));
            assert_null(strstr(text, "inf"));
            free(text);
        }
}

static void a_page_that_cannot_be_written_is_named(void **state)
{
    (void)state;
    struct page *page = page_create("page", NULL, &error);
    assert_false(page_write(page, "/nowhere/report.html", &error));
    assert_non_null(strstr(error.message, "/nowhere/report.html"));
    if (access("/dev/full", W_OK) == 0) {
        char full[96], part[104];
        snprintf(full, sizeof full, "%s/full.html", folder);
        snprintf(part, sizeof part, "%s.part", full);
        assert_int_equal(symlink("/dev/full", part), 0);
        assert_false(page_write(page, full, &error));
        assert_non_null(strstr(error.message, "full.html: No space left"));
        assert_int_not_equal(access(full, F_OK), 0);
    }
    page_destroy(&page);
}

int main(void)
{
    if (!mkdtemp(folder))
        return 1;
    snprintf(path, sizeof path, "%s/page.html", folder);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_page_is_well_formed), cmocka_unit_test(pictures_are_inside),
        cmocka_unit_test(points_lie_where_the_axes_say), cmocka_unit_test(axes_have_ticks),
        cmocka_unit_test(a_page_that_cannot_be_written_is_named)};
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    unlink(path);
    rmdir(folder);
    return failed;
}
