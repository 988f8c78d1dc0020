/* config_internal.h: what the command line (config.c) and the file (config_file.c) share. */
#ifndef CAUSTIC_BENCH_CONFIG_INTERNAL_H
#define CAUSTIC_BENCH_CONFIG_INTERNAL_H

#include "config.h"

/* Refuses the settings that a point cannot have. */
bool config_check_setting(const char *name, struct error *error);

/* The axis or method of that name, emptied; a new one when there is none. NULL on error. */
struct bench_axis *config_axis(struct bench_config *config, const char *name, struct error *error);
struct bench_group *config_method(struct bench_config *config, const char *name, struct error *error);

bool config_add_value(struct bench_axis *axis, const char *text, struct error *error);
bool config_add_setting(struct bench_group *group, const char *name, const char *value, struct error *error);
/* The first one clears the list, and judges. */
bool config_add_metric(struct bench_config *config, const char *name, bool is_first, struct error *error);

#endif
