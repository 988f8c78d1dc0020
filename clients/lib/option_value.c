#include "option_value.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void option_begin(void)
{
    optind = 0; /* glibc: anew, also when called again */
    opterr = 0;
}

int option_next(int argc, char **argv, const struct option *table, const char **value, struct error *error)
{
    int option = getopt_long(argc, argv, ":", table, NULL);
    bool is_good = true;
    if (option == ':')
        is_good = error_set(error, STATUS_INVALID, "%.100s needs a value", argv[optind - 1]);
    else if (option == '?')
        is_good = error_set(error, STATUS_INVALID, "there is no option %.100s; --help lists them",
                            argv[optind - 1]);
    else if (option == OPTION_END && optind < argc)
        is_good = error_set(error, STATUS_INVALID, "%.100s is no option; --help lists them", argv[optind]);
    *value = optarg ? optarg : "";
    return is_good ? option : OPTION_WRONG;
}

bool option_number(const char *option, const char *text, double minimum, double maximum, double *value,
                   struct error *error)
{
    char *end;
    *value = strtod(text, &end);
    if (end == text || *end || !isfinite(*value))
        return error_set(error, STATUS_INVALID, "--%s %.100s: not a number", option, text);
    if (*value < minimum || *value > maximum)
        return error_set(error, STATUS_INVALID, "--%s %.100s: must be between %.9g and %.9g", option, text,
                         minimum, maximum);
    return true;
}

bool option_count(const char *option, const char *text, uint32_t minimum, uint32_t *value,
                  struct error *error)
{
    double number;
    if (!option_number(option, text, minimum, 1e6, &number, error))
        return false;
    if (number != floor(number))
        return error_set(error, STATUS_INVALID, "--%s %.100s: must be a whole number", option, text);
    *value = (uint32_t)number;
    return true;
}

bool option_vector(const char *option, const char *text, float *vector, struct error *error)
{
    const char *at = text;
    for (int i = 0; i < 3; i++) {
        char *end;
        vector[i] = strtof(at, &end);
        if (end == at || *end != (i < 2 ? ',' : 0) || !isfinite(vector[i]))
            return error_set(error, STATUS_INVALID,
                             "--%s %.100s: write three numbers with commas, as in 0,1.5,-2", option, text);
        at = end + 1;
    }
    return true;
}

bool option_size(const char *text, uint32_t *width, uint32_t *height, struct error *error)
{
    char rest;
    if (strspn(text, "0123456789x") != strlen(text) || strlen(text) > 15 ||
        sscanf(text, "%ux%u%c", width, height, &rest) != 2)
        return error_set(error, STATUS_INVALID, "--size %.100s: write WIDTHxHEIGHT in pixels, as in 480x270",
                         text);
    if (*width == 0 || *height == 0)
        return error_set(error, STATUS_INVALID, "--size %.100s: width and height must be at least 1", text);
    return true;
}

bool option_address(const char *text, struct error *error)
{
    return strncmp(text, "tcp:", 4) == 0 || strncmp(text, "unix:", 5) == 0 ||
           error_set(error, STATUS_INVALID, "--connect %.100s: write tcp:HOST:PORT or unix:PATH", text);
}

bool option_setting(const char *text, struct option_setting *setting, struct error *error)
{
    const char *equals = strchr(text, '=');
    if (!equals || equals == text || !equals[1])
        return error_set(error, STATUS_INVALID, "--set %.100s: write NAME=VALUE, as in photons=500000", text);
    if ((size_t)(equals - text) >= sizeof setting->name || strlen(equals + 1) >= sizeof setting->value)
        return error_set(error, STATUS_INVALID, "--set %.100s: too long to be a setting", text);
    memcpy(setting->name, text, (size_t)(equals - text));
    setting->name[equals - text] = 0;
    memcpy(setting->value, equals + 1, strlen(equals + 1) + 1);
    return true;
}
