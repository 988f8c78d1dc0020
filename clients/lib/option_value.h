/* option_value.h: a command line's options and what their values look like, the same in every program.
 *
 * Errors name the option and the value and say what is allowed.
 */
#ifndef CAUSTIC_OPTION_VALUE_H
#define CAUSTIC_OPTION_VALUE_H

#include <getopt.h>
#include <stdint.h>

#include "../../core/status.h"

/* The options of `argv` one after another, of programs that take nothing else:
 *
 *     const char *value;
 *     option_begin();
 *     for (int option; (option = option_next(argc, argv, table, &value, error)) != OPTION_END;)
 *         if (option == OPTION_WRONG || ...)
 *             return false;
 *
 * `table` is getopt_long's, with numbers from 256 on; *value is "" for an option without one, and part of
 * `argv`. One command line at a time. */
enum { OPTION_END = -1, OPTION_WRONG = -2 };

void option_begin(void);
int option_next(int argc, char **argv, const struct option *table, const char **value, struct error *error);

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
