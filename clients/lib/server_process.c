#define _GNU_SOURCE
#include "server_process.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "transport.h"

#define READY_MS     120000u
#define STOP_MS      10000
#define SIGNAL_MS    3000 /* that a signal waits for the server's orderly end */
#define MAX_SERVERS  8u
#define ADDRESS_SIZE 104u /* a socket's path must fit struct sockaddr_un */

struct server_process {
    pid_t pid; /* 0: ended */
    int wait_status;
    char folder[ADDRESS_SIZE], socket[ADDRESS_SIZE], log[ADDRESS_SIZE], address[ADDRESS_SIZE + 8];
};

/* What a signal has to end. Of static duration because a handler can reach nothing else. */
static struct server_process *volatile running[MAX_SERVERS];

/* ---- the end ------------------------------------------------------------------------------------------- */

/* Async-signal-safe. Whether the process ended in time; its status is then in wait_status. */
static bool await_end(struct server_process *process, int milliseconds)
{
    for (int waited = 0;; waited += 5) {
        int status;
        pid_t ended = waitpid(process->pid, &status, WNOHANG);
        if (ended != 0) {
            process->wait_status = ended > 0 ? status : 0;
            process->pid = 0;
            return true;
        }
        if (waited >= milliseconds)
            return false;
        nanosleep(&(struct timespec){.tv_nsec = 5000000}, NULL);
    }
}

/* Async-signal-safe. */
static void end_process(struct server_process *process, int milliseconds)
{
    if (process->pid > 0) {
        kill(process->pid, SIGTERM);
        if (!await_end(process, milliseconds)) {
            kill(process->pid, SIGKILL);
            await_end(process, STOP_MS);
        }
    }
    unlink(process->socket);
    unlink(process->log);
    rmdir(process->folder);
}

static void on_signal(int number)
{
    for (uint32_t i = 0; i < MAX_SERVERS; i++)
        if (running[i])
            end_process(running[i], SIGNAL_MS);
    /* The action was reset on entry; the signal comes once this returns. */
    raise(number);
}

static void catch_signals(void)
{
    static const int numbers[] = {SIGINT, SIGTERM, SIGHUP};
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) {
        struct sigaction action;
        if (sigaction(numbers[i], NULL, &action) != 0 || action.sa_handler != SIG_DFL)
            continue;
        memset(&action, 0, sizeof action);
        action.sa_handler = on_signal;
        action.sa_flags = (int)SA_RESETHAND;
        sigaction(numbers[i], &action, NULL);
    }
}

/* The last line that tells of an error, or else the last that is not empty; empty when there is none. */
static void last_words(const struct server_process *process, char *line, size_t size)
{
    char text[4096];
    *line = 0;
    int file = open(process->log, O_RDONLY | O_CLOEXEC);
    if (file < 0)
        return;
    off_t length = lseek(file, 0, SEEK_END), start = length - (off_t)sizeof text + 1;
    ssize_t got = pread(file, text, sizeof text - 1, start > 0 ? start : 0);
    close(file);
    if (got <= 0)
        return;
    text[got] = 0;
    char *save = NULL;
    bool has_error = false;
    for (char *at = strtok_r(text, "\n", &save); at; at = strtok_r(NULL, "\n", &save)) {
        bool is_error = strstr(at, "error: ") != NULL;
        if (is_error || !has_error)
            snprintf(line, size, "%s", at);
        has_error |= is_error;
    }
}

static bool explain_end(const struct server_process *process, struct error *error)
{
    char words[300], how[64];
    last_words(process, words, sizeof words);
    int status = process->wait_status;
    if (WIFSIGNALED(status))
        snprintf(how, sizeof how, "was ended by signal %d", WTERMSIG(status));
    else
        snprintf(how, sizeof how, "ended with status %d", WEXITSTATUS(status));
    return error_set(error, STATUS_IO, "causticd %s%s%s", how, *words ? "; it last said: " : "", words);
}

/* ---- the start ----------------------------------------------------------------------------------------- */

static bool find_program(const char *given, char *path, size_t size, struct error *error)
{
    ssize_t length = -1;
    if (given) {
        length = snprintf(path, size, "%s", given);
    } else {
        length = readlink("/proc/self/exe", path, size - 1);
        if (length > 0) {
            path[length] = 0;
            char *slash = strrchr(path, '/');
            size_t used = (size_t)(slash + 1 - path);
            length = (ssize_t)used + snprintf(slash + 1, size - used, "causticd");
        }
    }
    if (length <= 0 || (size_t)length >= size)
        return error_set(error, STATUS_INVALID, "the path of causticd is too long or unknown");
    if (access(path, X_OK) != 0)
        return error_set(error, STATUS_NOT_FOUND, "%.300s: %s", path, strerror(errno));
    return true;
}

static bool make_folder(struct server_process *process, struct error *error)
{
    const char *base = getenv("TMPDIR");
    if (!base || !*base || strlen(base) > 64) /* a socket's path has room for about 100 bytes */
        base = "/tmp";
    snprintf(process->folder, sizeof process->folder, "%s/causticd-XXXXXX", base);
    if (!mkdtemp(process->folder))
        return error_set(error, STATUS_IO, "%.100s: %s", process->folder, strerror(errno));
    snprintf(process->socket, sizeof process->socket, "%.90s/socket", process->folder);
    snprintf(process->log, sizeof process->log, "%.90s/log", process->folder);
    snprintf(process->address, sizeof process->address, "unix:%s", process->socket);
    return true;
}

static bool launch(struct server_process *process, const char *path,
                   const struct server_process_params *params, int out, struct error *error)
{
    const char *list[SERVER_PROCESS_MAX_ARGUMENTS + 6];
    size_t count = 0;
    list[count++] = path;
    if (params->scene)
        list[count++] = params->scene;
    list[count++] = "--listen";
    list[count++] = process->address;
    for (size_t i = 0; params->arguments && params->arguments[i]; i++) {
        if (i == SERVER_PROCESS_MAX_ARGUMENTS)
            return error_set(error, STATUS_LIMIT, "causticd takes at most %u options here",
                             SERVER_PROCESS_MAX_ARGUMENTS);
        list[count++] = params->arguments[i];
    }
    list[count] = NULL;
    int log = open(process->log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
    if (log < 0)
        return error_set(error, STATUS_IO, "%s: %s", process->log, strerror(errno));
    pid_t parent = getpid(), pid = fork();
    if (pid == 0) {
        setpgid(0, 0);
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        if (getppid() != parent)
            _exit(127);
        dup2(out, STDOUT_FILENO);
        dup2(log, STDERR_FILENO);
        execv(path, (char *const *)(uintptr_t)list);
        _exit(127);
    }
    close(log);
    if (pid < 0)
        return error_set(error, STATUS_LIMIT, "no process for causticd: %s", strerror(errno));
    process->pid = pid;
    return true;
}

/* Reads its standard output until a whole line tells the address. */
static bool await_ready(struct server_process *process, int out, uint32_t ready_ms, struct error *error)
{
    char text[4096] = "";
    size_t size = 0, kept = sizeof text / 2;
    int64_t end = transport_now_ms() + ready_ms;
    for (;;) {
        int64_t left = end - transport_now_ms();
        struct pollfd poll_fd = {.fd = out, .events = POLLIN};
        int ready = left > 0 ? poll(&poll_fd, 1, (int)left) : 0;
        if (ready < 0 && errno == EINTR)
            continue;
        if (ready <= 0)
            return error_set(error, STATUS_LIMIT, "causticd was not ready within %u s", ready_ms / 1000);
        if (size == sizeof text - 1) {
            memmove(text, text + size - kept, kept);
            size = kept;
        }
        ssize_t got = read(out, text + size, sizeof text - 1 - size);
        if (got <= 0) {
            if (!await_end(process, STOP_MS))
                return error_set(error, STATUS_IO, "causticd closed its output before it was ready");
            return explain_end(process, error);
        }
        size += (size_t)got;
        text[size] = 0;
        const char *line = strstr(text, "causticd: ready on unix:");
        if (line && strchr(line, '\n'))
            return true;
    }
}

struct server_process *server_process_start(const struct server_process_params *params, struct error *error)
{
    char path[4096];
    int out[2] = {-1, -1};
    uint32_t slot = 0;
    while (slot < MAX_SERVERS && running[slot])
        slot++;
    if (slot == MAX_SERVERS) {
        error_set(error, STATUS_LIMIT, "at most %u servers at a time", MAX_SERVERS);
        return NULL;
    }
    struct server_process *process = calloc(1, sizeof *process);
    if (!process) {
        error_set(error, STATUS_MEMORY, "no memory for a server");
        return NULL;
    }
    if (!find_program(params->program, path, sizeof path, error) || !make_folder(process, error)) {
        free(process);
        return NULL;
    }
    catch_signals();
    running[slot] = process;
    bool is_ready = false;
    if (pipe2(out, O_CLOEXEC) != 0) {
        error_set(error, STATUS_LIMIT, "no pipe to causticd: %s", strerror(errno));
    } else if (launch(process, path, params, out[1], error)) {
        close(out[1]);
        out[1] = -1;
        is_ready = await_ready(process, out[0], params->ready_ms ? params->ready_ms : READY_MS, error);
    }
    for (int i = 0; i < 2; i++)
        if (out[i] >= 0)
            close(out[i]);
    if (!is_ready) {
        struct error ignored;
        server_process_stop(&process, &ignored);
    }
    return process;
}

const char *server_process_address(const struct server_process *process)
{
    return process->address;
}

bool server_process_is_alive(struct server_process *process, struct error *error)
{
    if (process->pid > 0 && !await_end(process, 0))
        return true;
    return explain_end(process, error);
}

bool server_process_stop(struct server_process **process, struct error *error)
{
    struct server_process *ending = *process;
    if (!ending)
        return true;
    bool was_alive = server_process_is_alive(ending, error), is_orderly = was_alive;
    if (was_alive) {
        kill(ending->pid, SIGTERM);
        is_orderly = await_end(ending, STOP_MS) && ending->wait_status == 0;
        if (!is_orderly && ending->pid > 0)
            error_set(error, STATUS_LIMIT, "causticd did not end within %d s of SIGTERM and was killed",
                      STOP_MS / 1000);
        else if (!is_orderly)
            explain_end(ending, error);
    }
    end_process(ending, 0);
    for (uint32_t i = 0; i < MAX_SERVERS; i++)
        if (running[i] == ending)
            running[i] = NULL;
    free(ending);
    *process = NULL;
    return is_orderly;
}
