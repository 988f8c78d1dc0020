#include "log.h"

#include <stdarg.h>
#include <stdio.h>

static enum log_level limit = LOG_LEVEL_INFO;

void log_set_level(enum log_level level)
{
    limit = level;
}

enum log_level log_get_level(void)
{
    return limit;
}

void log_line(enum log_level level, const char *format, ...)
{
    if (level > limit)
        return;
    static const char *const prefixes[] = {"error: ", "warning: ", "", ""};
    char line[1024];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(line, sizeof line, format, arguments);
    va_end(arguments);
    fprintf(stderr, "causticd: %s%s\n", prefixes[level], line);
}
