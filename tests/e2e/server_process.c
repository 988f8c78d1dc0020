#define _GNU_SOURCE
#include "server_process.h"

#include "tests/support/check.h"
#include "tests/support/program.h"

#include <dirent.h>
#include <fcntl.h>
#include <ftw.h>
#include <poll.h>
#include <signal.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

/* To compile every pipeline on a slow machine under a sanitizer. */
#define READY_SECONDS 120.0

char *server_log(const struct server_process *server)
{
    return program_read(server->log_path);
}

static void fail_with_log(struct server_process *server, const char *what)
{
    char *log = server_log(server);
    print_error("%s; its log:\n%s\n", what, log);
    free(log);
    server_clean(server);
    fail();
}

/* Reads lines of stdout until both addresses were told. */
static void await_ready(struct server_process *server, int out)
{
    static const char ready[] = "causticd: ready on ";
    char text[4096];
    size_t size = 0;
    double end = seconds_now() + READY_SECONDS;
    while (!server->unix_address[0] || !server->tcp_address[0]) {
        struct pollfd poll_fd = {.fd = out, .events = POLLIN};
        double left = end - seconds_now();
        ssize_t got = 0;
        if (left > 0 && poll(&poll_fd, 1, (int)(left * 1000)) > 0)
            got = read(out, text + size, sizeof text - 1 - size);
        if (got <= 0) {
            fail_with_log(server,
                          left > 0 ? "the server ended before it was ready" : "the server was not ready");
            return;
        }
        size += (size_t)got;
        text[size] = 0;
        char *line = text;
        for (char *end_of_line; (end_of_line = strchr(line, '\n')); line = end_of_line + 1) {
            *end_of_line = 0;
            const char *address = strncmp(line, ready, sizeof ready - 1) == 0 ? line + sizeof ready - 1 : "";
            if (strncmp(address, "unix:", 5) == 0)
                snprintf(server->unix_address, sizeof server->unix_address, "%s", address);
            else if (strncmp(address, "tcp:", 4) == 0)
                snprintf(server->tcp_address, sizeof server->tcp_address, "%s", address);
        }
        size = strlen(line);
        memmove(text, line, size + 1);
    }
}

void server_start(struct server_process *server, const struct server_params *params)
{
    *server = (struct server_process){.folder = "/tmp/causticd-test-XXXXXX"};
    char path[4096], unix_option[160], *arguments[SERVER_MAX_ARGUMENTS + 12];
    program_path(params->program ? params->program : "causticd-fake", path, sizeof path);
    assert_non_null(mkdtemp(server->folder));
    snprintf(server->socket_path, sizeof server->socket_path, "%s/socket", server->folder);
    snprintf(server->log_path, sizeof server->log_path, "%s/log", server->folder);
    snprintf(unix_option, sizeof unix_option, "unix:%s", server->socket_path);
    size_t count = 0;
    arguments[count++] = path;
    if (params->scene)
        arguments[count++] = (char *)(uintptr_t)params->scene;
    static char *const own[] = {"--log-level", "debug", "--listen", "tcp:127.0.0.1:0", "--listen"};
    for (size_t i = 0; i < sizeof own / sizeof *own; i++)
        arguments[count++] = own[i];
    arguments[count++] = unix_option;
    for (size_t i = 0; i < SERVER_MAX_ARGUMENTS && params->arguments[i]; i++)
        arguments[count++] = (char *)(uintptr_t)params->arguments[i];
    arguments[count] = NULL;
    int out[2], log = open(server->log_path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
    assert_true(log >= 0 && pipe2(out, O_CLOEXEC) == 0);
    server->pid = program_spawn(path, arguments, out[1], log);
    close(out[1]);
    close(log);
    await_ready(server, out[0]);
    close(out[0]);
}

int server_wait(struct server_process *server, int signal, double seconds)
{
    if (signal)
        kill(server->pid, signal);
    int status = program_wait(server->pid, seconds);
    if (status < 0)
        fail_with_log(server, "the server does not end");
    server->pid = 0;
    return status;
}

static int remove_entry(const char *path, const struct stat *status, int type, struct FTW *walk)
{
    (void)status;
    (void)type;
    (void)walk;
    return remove(path);
}

void server_clean(struct server_process *server)
{
    if (server->pid > 0) {
        kill(server->pid, SIGKILL);
        waitpid(server->pid, NULL, 0);
        server->pid = 0;
    }
    if (server->folder[0])
        nftw(server->folder, remove_entry, 8, FTW_DEPTH | FTW_PHYS);
    server->folder[0] = 0;
}

void server_stop(struct server_process *server)
{
    int status = server_wait(server, SIGTERM, 10);
    if (status != 0)
        fail_with_log(server, "the server did not exit with 0");
    assert_int_not_equal(access(server->socket_path, F_OK), 0);
    server_clean(server);
}

uint64_t server_memory(const struct server_process *server)
{
    char path[64];
    unsigned long long pages = 0;
    snprintf(path, sizeof path, "/proc/%d/statm", (int)server->pid);
    FILE *file = fopen(path, "r");
    assert_non_null(file);
    assert_int_equal(fscanf(file, "%*u %llu", &pages), 1);
    fclose(file);
#ifdef __SANITIZE_ADDRESS__
    pages = 0;
#endif
    return pages * (uint64_t)sysconf(_SC_PAGESIZE);
}

uint32_t server_descriptors(const struct server_process *server)
{
    char path[64];
    snprintf(path, sizeof path, "/proc/%d/fd", (int)server->pid);
    DIR *folder = opendir(path);
    assert_non_null(folder);
    uint32_t count = 0;
    while (readdir(folder))
        count++;
    closedir(folder);
    return count - 2;
}
