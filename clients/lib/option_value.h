/* option_value.h: what the values of command-line options look like, the same in every program.
 *
 * Errors name the option and the value and say what is allowed.
 */
#ifndef CAUSTIC_OPTION_VALUE_H
#define CAUSTIC_OPTION_VALUE_H

#include <stdint.h>

#include "../../core/status.h"

bool option_number(const char *option, const char *text, double minimum, double maximum, double *value,
                   struct error *error);

/* A whole number of at most a million. */
bool option_count(const char *option, const char *text, uint32_t minimum, uint32_t *value,
                  struct error *error);

/* Three numbers with commas. */
bool option_vector(const char *option, const char *text, float *vector, struct error *error);

/* WIDTHxHEIGHT, of --size. */
bool option_size(const char *text, uint32_t *width, uint32_t *height, struct error *error);

/* tcp:HOST:PORT or unix:PATH, of --connect. */
bool option_address(const char *text, struct error *error);

/* NAME=VALUE, of --set. What the names are only a server knows. */
struct option_setting {
    char name[64], value[64];
};

bool option_setting(const char *text, struct option_setting *setting, struct error *error);

#endif
