/* log.h: what the server says to the person who runs it, on stderr.
 *
 * One line per event: "causticd: TEXT", with "warning: " or "error: " where it is one. Lines of different
 * threads do not mix.
 */
#ifndef CAUSTICD_LOG_H
#define CAUSTICD_LOG_H

enum log_level { LOG_LEVEL_ERROR, LOG_LEVEL_WARNING, LOG_LEVEL_INFO, LOG_LEVEL_DEBUG };

/* Set once before the threads start; LOG_LEVEL_INFO until then. */
void log_set_level(enum log_level level);
enum log_level log_get_level(void);
void log_line(enum log_level level, const char *format, ...) __attribute__((format(printf, 2, 3)));

#endif
