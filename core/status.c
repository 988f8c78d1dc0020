#include "status.h"

#include <stdarg.h>
#include <stdio.h>

bool error_set(struct error *error, enum status status, const char *format, ...)
{
    error->status = status;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(error->message, sizeof error->message, format, arguments);
    va_end(arguments);
    return false;
}

const char *status_name(enum status status)
{
    static const char *const names[] = {"ok",    "invalid",          "not found",     "unsupported",
                                        "limit", "input and output", "Vulkan device", "out of memory"};
    return (unsigned)status < sizeof names / sizeof *names ? names[status] : "unknown";
}
