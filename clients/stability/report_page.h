/* report_page.h: report.json as a page: every measure, plots of every series, pictures. */
#ifndef CAUSTIC_STABILITY_REPORT_PAGE_H
#define CAUSTIC_STABILITY_REPORT_PAGE_H

#include <jansson.h>

#include "../../core/status.h"

/* `root` as report.h describes it, pictures in `folder`. */
bool report_page_write(json_t *root, const char *folder, const char *path, struct error *error);

#endif
