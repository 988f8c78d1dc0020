#define _GNU_SOURCE
#include "server.h"

#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* ---- signals ------------------------------------------------------------------------------------------ */

/* A signal handler has no other way to reach these. */
static atomic_int signal_count;
static _Atomic(struct network *) signal_network;

static void on_signal(int number)
{
    (void)number;
    if (atomic_fetch_add(&signal_count, 1) > 0)
        _exit(1);
    struct network *network = atomic_load(&signal_network);
    if (network)
        network_wake(network);
}

static void catch_signals(void)
{
    struct sigaction action = {.sa_handler = on_signal, .sa_flags = SA_RESTART};
    sigemptyset(&action.sa_mask);
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGINT, &action, NULL);
    signal(SIGPIPE, SIG_IGN);
}

/* ---- callbacks of the network ------------------------------------------------------------------------- */

static void *on_opened(void *user, struct connection *connection, const char *peer)
{
    return session_create(user, connection, peer);
}

static size_t on_refusal(void *user, const char *reason, uint8_t *bytes, size_t capacity)
{
    struct server *server = user;
    struct protocol_message *message = &server->outgoing;
    message->header = (struct protocol_header){.type = PROTOCOL_NOTICE};
    message->notice = (struct protocol_notice){
        .kind = PROTOCOL_NOTICE_CLOSING, .status = STATUS_LIMIT, .text = protocol_text_of(reason)};
    struct error error;
    return protocol_encode(message, bytes, capacity, &error);
}

static void on_received(void *session, const uint8_t *bytes, size_t size)
{
    session_receive(session, bytes, size);
}

static size_t on_next_output(void *session, const uint8_t **bytes)
{
    return output_next(session, bytes);
}

static void on_closed(void *session)
{
    session_destroy(session);
}

/* ---- the end ------------------------------------------------------------------------------------------ */

static void close_sessions(struct server *server)
{
    for (struct session *session = server->sessions; session; session = session->next)
        session_close(session, server->is_device_lost ? STATUS_DEVICE : STATUS_OK,
                      server->is_device_lost ? "the Vulkan device is lost" : "the server is shutting down");
    server->drain_end_ns = network_now_ns() + DRAIN_NS;
}

static void begin_drain(struct server *server)
{
    struct error reason;
    if (server->is_device_lost)
        error_set(&reason, STATUS_DEVICE, "the Vulkan device is lost");
    else
        error_set(&reason, STATUS_UNSUPPORTED, "the server is shutting down");
    log_line(server->is_device_lost ? LOG_LEVEL_ERROR : LOG_LEVEL_INFO, "%s", reason.message);
    server->is_draining = true;
    network_stop_listening(server->network);
    views_cancel(server, &reason);
}

static void on_woken(void *user)
{
    struct server *server = user;
    views_collect(server);
    if (!server->is_draining && (atomic_load(&signal_count) || server->is_device_lost))
        begin_drain(server);
    if (server->is_draining && !server->jobs_at_work && !server->drain_end_ns)
        close_sessions(server);
    if (server->drain_end_ns && !server->sessions)
        network_stop(server->network);
}

static void on_ticked(void *user)
{
    struct server *server = user;
    uint64_t now = network_now_ns();
    if (server->drain_end_ns && (!server->sessions || now > server->drain_end_ns))
        network_stop(server->network);
    for (struct session *session = server->sessions, *next; session; session = next) {
        next = session->next;
        session_tick(session, now);
    }
}

/* ---- the beginning ------------------------------------------------------------------------------------ */

static void on_gpu_log(void *user, enum gpu_log_level level, const char *text)
{
    (void)user;
    static const enum log_level levels[] = {[GPU_LOG_INFO] = LOG_LEVEL_DEBUG,
                                            [GPU_LOG_WARNING] = LOG_LEVEL_WARNING,
                                            [GPU_LOG_ERROR] = LOG_LEVEL_ERROR};
    log_line(levels[level], "%s", text);
}

static void on_job_finished(void *user)
{
    struct server *server = user;
    network_wake(server->network);
}

static bool write_ready_file(const char *path, const struct listener *listeners, uint32_t count,
                             struct error *error)
{
    char temporary[4096];
    int length = snprintf(temporary, sizeof temporary, "%s.partial", path);
    FILE *file = length > 0 && (size_t)length < sizeof temporary ? fopen(temporary, "w") : NULL;
    bool ok = file != NULL;
    for (uint32_t i = 0; ok && i < count; i++)
        ok = fprintf(file, "%s\n", listeners[i].address) > 0;
    if (file)
        ok = fclose(file) == 0 && ok;
    /* Whoever waits for the file finds it complete. */
    ok = ok && rename(temporary, path) == 0;
    return ok || error_set(error, STATUS_IO, "--ready-file: cannot write %s", path);
}

static bool announce(const struct server *server, struct listener *listeners, uint32_t count,
                     struct error *error)
{
    if (server->options->ready_file &&
        !write_ready_file(server->options->ready_file, listeners, count, error))
        return false;
    for (uint32_t i = 0; i < count; i++)
        printf("causticd: ready on %s\n", listeners[i].address);
    fflush(stdout);
    return true;
}

static bool start(struct server *server, struct listener *listeners, struct error *error)
{
    const struct options *options = server->options;
    server->network = network_create(&(struct network_params){.callbacks = {.opened = on_opened,
                                                                            .refusal = on_refusal,
                                                                            .received = on_received,
                                                                            .next_output = on_next_output,
                                                                            .closed = on_closed,
                                                                            .woken = on_woken,
                                                                            .ticked = on_ticked},
                                                              .user = server,
                                                              .max_connections = options->max_clients,
                                                              .stall_seconds = options->stall_seconds},
                                     error);
    if (!server->network)
        return false;
    server->render =
        render_thread_start(&(struct render_thread_params){.gpu = {.device = options->device,
                                                                   .cache_dir = options->cache_dir,
                                                                   .validation = options->validation,
                                                                   .log = on_gpu_log},
                                                           .scene = server->scene,
                                                           .tracer = options->tracer,
                                                           .finished = on_job_finished,
                                                           .user = server},
                            error);
    if (!server->render)
        return false;
    const struct render_info *render = render_thread_info(server->render);
    server->max_pixels = render->limits.max_pixels;
    if (options->size_limit && options->size_limit < server->max_pixels)
        server->max_pixels = options->size_limit;
    log_line(LOG_LEVEL_INFO, "%s on %s (%s), tracer %s", server->scene->name, render->gpu.name,
             render->gpu.driver, render->tracer == TRACER_KHR ? "khr" : "bvh");
    if (!hello_make(server, error))
        return false;
    for (uint32_t i = 0; i < options->listen_count; i++)
        if (!network_listen(server->network, &listeners[i], error))
            return false;
    return true;
}

static void finish(struct server *server)
{
    atomic_store(&signal_network, NULL);
    /* The render thread first: it wakes the network. */
    if (server->render)
        render_thread_stop(&server->render);
    network_destroy(&server->network);
    views_destroy(server);
    free(server->hello);
    free(server);
}

int server_run(const struct options *options, const struct scene *scene)
{
    struct listener listeners[LISTENER_MAX_COUNT];
    uint32_t open_count = 0;
    struct error error;
    struct server *server = calloc(1, sizeof *server);
    bool ok = server || error_set(&error, STATUS_MEMORY, "out of memory");
    if (server) {
        server->options = options;
        server->scene = scene;
    }
    catch_signals();
    /* Listening before the pipelines are compiled: an address in use is told at once, and whoever connects
     * early is served when the server is ready. */
    for (; ok && open_count < options->listen_count; open_count += ok) {
        ok =
            listener_open(&listeners[open_count], options->listen[open_count], options->allow_remote, &error);
        if (ok && listeners[open_count].is_remote)
            log_line(LOG_LEVEL_WARNING, "%s can be reached from other machines, without authentication",
                     listeners[open_count].address);
    }
    ok = ok && start(server, listeners, &error) && announce(server, listeners, open_count, &error);
    if (ok) {
        atomic_store(&signal_network, server->network);
        network_wake(server->network); /* a signal may have come before there was something to wake */
        network_run(server->network);
        ok = !server->is_device_lost;
    } else {
        log_line(LOG_LEVEL_ERROR, "%s", error.message);
    }
    if (server)
        finish(server);
    for (uint32_t i = 0; i < open_count; i++)
        listener_close(&listeners[i]);
    return ok ? 0 : 1;
}
