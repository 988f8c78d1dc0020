#define _GNU_SOURCE
#include "program.h"

#include "check.h"

#include <fcntl.h>
#include <signal.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#define SECONDS 240.0

char program_output[1 << 16];

double seconds_now(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static const char *programs(void)
{
    const char *folder = getenv("CAUSTICD_BIN_DIR");
    if (!folder)
        fail_msg("CAUSTICD_BIN_DIR is not set: run the tests through ctest");
    return folder;
}

void program_path(const char *program, char *path, size_t size)
{
    snprintf(path, size, "%s/%s", programs(), program);
    if (access(path, X_OK) != 0)
        fail_msg("%s was not built", path);
}

pid_t program_spawn(const char *path, char *const *arguments, int out, int err)
{
    pid_t parent = getpid(), pid = fork();
    assert_true(pid >= 0);
    if (pid == 0) {
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        if (getppid() != parent)
            _exit(127);
        dup2(out, STDOUT_FILENO);
        dup2(err, STDERR_FILENO);
        execv(path, arguments);
        _exit(127);
    }
    return pid;
}

int program_wait(pid_t pid, double seconds)
{
    int status;
    double end = seconds_now() + seconds;
    while (waitpid(pid, &status, WNOHANG) != pid) {
        if (seconds_now() > end)
            return -1;
        nanosleep(&(struct timespec){.tv_nsec = 2000000}, NULL);
    }
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

static void read_into(const char *path, char *text, size_t size)
{
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    size_t length = 0;
    for (ssize_t got; fd >= 0 && length < size - 1 && (got = read(fd, text + length, size - 1 - length)) > 0;)
        length += (size_t)got;
    text[length] = 0;
    if (fd >= 0)
        close(fd);
}

char *program_read(const char *path)
{
    char *text = malloc(sizeof program_output);
    assert_non_null(text);
    read_into(path, text, sizeof program_output);
    return text;
}

static int run(const char *folder, const char *command)
{
    char output[] = "/tmp/causticd-test-XXXXXX", line[8192];
    int length = snprintf(line, sizeof line, "PATH='%s':\"$PATH\"; %s%s%sexec %s", programs(),
                          folder ? "cd '" : "", folder ? folder : "", folder ? "' && " : "", command);
    assert_in_range(length, 1, sizeof line - 1);
    int fd = mkostemp(output, O_CLOEXEC);
    assert_true(fd >= 0);
    char *arguments[] = {"sh", "-c", line, NULL};
    pid_t pid = program_spawn("/bin/sh", arguments, fd, fd);
    close(fd);
    int status = program_wait(pid, SECONDS);
    if (status < 0) {
        kill(pid, SIGKILL);
        waitpid(pid, NULL, 0);
    }
    read_into(output, program_output, sizeof program_output);
    unlink(output);
    if (status < 0 || status == 126 || status == 127)
        fail_msg("%s %s:\n%s", command, status < 0 ? "does not end" : "cannot be run", program_output);
    return status;
}

#define FORMATTED(command, format)                                                                           \
    char command[4096];                                                                                      \
    va_list list;                                                                                            \
    va_start(list, format);                                                                                  \
    assert_true(vsnprintf(command, sizeof command, format, list) < (int)sizeof command);                     \
    va_end(list)

int program_run(const char *folder, const char *format, ...)
{
    FORMATTED(command, format);
    return run(folder, command);
}

void program_expect(int status, const char *part, const char *folder, const char *format, ...)
{
    FORMATTED(command, format);
    int got = run(folder, command);
    if (got != status || !strstr(program_output, part))
        fail_msg("%s: exit %d, wanted %d and \"%s\":\n%s", command, got, status, part, program_output);
}

void program_needs_device(void)
{
    if (run(NULL, "causticd --list-devices") != 0)
        skip_program("there is no Vulkan device");
}
