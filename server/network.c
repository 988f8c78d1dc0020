#define _GNU_SOURCE
#include "network.h"

#include "log.h"

#include <errno.h>
#include <fcntl.h>
#include <libwebsockets.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <arpa/inet.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

/* How long a finished connection waits for its client to close first. Closing at once would reset the
 * connection when bytes of the client are still unread, and the reset can overtake the last message. */
#define LINGER_NS         1000000000ull
#define ACCEPTS_PER_TURN  16
#define FAILED_ACCEPT_NS  10000000
#define SPARE_DESCRIPTORS 64u /* of the process, beside its connections */

enum connection_state {
    CONNECTION_OPEN,
    CONNECTION_FINISHING, /* sends what is left */
    CONNECTION_LINGERING, /* sent everything, said so, waits for the client to close */
    CONNECTION_ABORTING
};

struct connection {
    struct connection *previous, *next;
    struct network *network;
    struct lws *wsi;
    void *session;
    enum connection_state state;
    bool is_paused, wants_output;
    uint64_t progress_ns; /* when output was last taken, or asked for while there was none */
};

struct network {
    struct network_params params;
    struct lws_context *context;
    struct lws_vhost *vhost;
    struct connection *connections;
    uint32_t connection_count;
    struct lws *listeners[LISTENER_MAX_COUNT];
    uint32_t listener_count;
    int spare_descriptor; /* given up for a moment to refuse a connection when there is no other left */
    bool is_stopped;
    lws_sorted_usec_list_t tick;
};

uint64_t network_now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000000ull + (uint64_t)now.tv_nsec;
}

/* ---- accepting ---------------------------------------------------------------------------------------- */

static void describe_peer(int fd, const struct sockaddr_storage *address, socklen_t size, char *text,
                          size_t capacity)
{
    char host[INET6_ADDRSTRLEN + 16], port[8];
    struct ucred peer;
    socklen_t peer_size = sizeof peer;
    if (address->ss_family == AF_UNIX && getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &peer, &peer_size) == 0)
        snprintf(text, capacity, "process %ld", (long)peer.pid);
    else if (address->ss_family != AF_UNIX &&
             getnameinfo((const struct sockaddr *)address, size, host, sizeof host, port, sizeof port,
                         NI_NUMERICHOST | NI_NUMERICSERV) == 0)
        snprintf(text, capacity, "%s port %s", host, port);
    else
        snprintf(text, capacity, "a local client");
}

/* Small replies go out at once, and a client whose machine vanished is noticed although it is owed nothing.
 */
static void tune_tcp(int fd)
{
    static const struct {
        int level, option, value;
    } options[] = {{IPPROTO_TCP, TCP_NODELAY, 1},
                   {SOL_SOCKET, SO_KEEPALIVE, 1},
                   {IPPROTO_TCP, TCP_KEEPIDLE, 60},
                   {IPPROTO_TCP, TCP_KEEPINTVL, 10},
                   {IPPROTO_TCP, TCP_KEEPCNT, 6}};
    for (size_t i = 0; i < sizeof options / sizeof *options; i++)
        setsockopt(fd, options[i].level, options[i].option, &options[i].value, sizeof options[i].value);
}

static void refuse(struct network *network, int fd, const char *reason)
{
    uint8_t bytes[1024];
    size_t size = network->params.callbacks.refusal(network->params.user, reason, bytes, sizeof bytes);
    /* A fresh socket takes so few bytes at once. */
    if (size && send(fd, bytes, size, MSG_NOSIGNAL | MSG_DONTWAIT) < 0)
        log_line(LOG_LEVEL_DEBUG, "a refused client did not take the reason: %s", strerror(errno));
    shutdown(fd, SHUT_WR);
    close(fd);
}

static void adopt(struct network *network, int fd, const char *peer)
{
    lws_sock_file_fd_type descriptor = {.sockfd = fd};
    struct lws *wsi =
        lws_adopt_descriptor_vhost(network->vhost, LWS_ADOPT_SOCKET, descriptor, "caustic-session", NULL);
    struct connection *connection = wsi ? calloc(1, sizeof *connection) : NULL;
    if (!connection) {
        log_line(LOG_LEVEL_WARNING, "cannot serve %s: out of memory or descriptors", peer);
        if (wsi)
            lws_set_timeout(wsi, PENDING_TIMEOUT_USER_OK, LWS_TO_KILL_ASYNC);
        return;
    }
    *connection = (struct connection){.network = network, .wsi = wsi, .next = network->connections};
    if (connection->next)
        connection->next->previous = connection;
    network->connections = connection;
    network->connection_count++;
    lws_set_opaque_user_data(wsi, connection);
    connection->session = network->params.callbacks.opened(network->params.user, connection, peer);
    if (!connection->session)
        connection_abort(connection);
}

static void accept_clients(struct network *network, int listener)
{
    for (int i = 0; i < ACCEPTS_PER_TURN; i++) {
        struct sockaddr_storage address;
        socklen_t size = sizeof address;
        int fd = accept4(listener, (struct sockaddr *)&address, &size, SOCK_NONBLOCK | SOCK_CLOEXEC);
        if (fd < 0 && (errno == EMFILE || errno == ENFILE) && network->spare_descriptor >= 0) {
            close(network->spare_descriptor);
            fd = accept4(listener, NULL, NULL, SOCK_NONBLOCK | SOCK_CLOEXEC);
            if (fd >= 0)
                refuse(network, fd, "the server is out of file descriptors");
            network->spare_descriptor = open("/dev/null", O_RDONLY | O_CLOEXEC);
            log_line(LOG_LEVEL_WARNING, "refused a client: no file descriptors left (ulimit -n)");
            continue;
        }
        if (fd < 0) {
            if (errno != EAGAIN && errno != EINTR && errno != ECONNABORTED) {
                log_line(LOG_LEVEL_WARNING, "accept: %s", strerror(errno));
                /* The listener stays readable: do not spin on it. */
                nanosleep(&(struct timespec){.tv_nsec = FAILED_ACCEPT_NS}, NULL);
            }
            return;
        }
        if (network->connection_count >= network->params.max_connections) {
            char reason[96];
            snprintf(reason, sizeof reason,
                     "the server already has the %u clients it allows; try again later",
                     network->params.max_connections);
            refuse(network, fd, reason);
            continue;
        }
        if (address.ss_family != AF_UNIX)
            tune_tcp(fd);
        char peer[96];
        describe_peer(fd, &address, size, peer, sizeof peer);
        adopt(network, fd, peer);
    }
}

/* ---- one connection ----------------------------------------------------------------------------------- */

static void forget(struct connection *connection)
{
    struct network *network = connection->network;
    if (connection->previous)
        connection->previous->next = connection->next;
    else
        network->connections = connection->next;
    if (connection->next)
        connection->next->previous = connection->previous;
    network->connection_count--;
    if (connection->session)
        network->params.callbacks.closed(connection->session);
    free(connection);
}

/* Returns -1 when the connection is to be closed. */
static int write_output(struct connection *connection)
{
    if (connection->state == CONNECTION_ABORTING)
        return -1;
    connection->progress_ns = network_now_ns();
    while (connection->state != CONNECTION_LINGERING) {
        if (lws_send_pipe_choked(connection->wsi)) {
            lws_callback_on_writable(connection->wsi);
            return 0;
        }
        const uint8_t *bytes = NULL;
        size_t size = connection->network->params.callbacks.next_output(connection->session, &bytes);
        if (!size) {
            connection->wants_output = false;
            if (connection->state == CONNECTION_OPEN)
                return 0;
            shutdown(lws_get_socket_fd(connection->wsi), SHUT_WR);
            connection->state = CONNECTION_LINGERING;
            lws_rx_flow_control(connection->wsi, 1);
            return 0;
        }
        /* lws does not change the bytes of raw connections; its interface is not const. */
        if (lws_write(connection->wsi, (unsigned char *)(uintptr_t)bytes, size, LWS_WRITE_RAW) < 0)
            return -1;
    }
    return 0;
}

void connection_want_output(struct connection *connection)
{
    if (connection->wants_output || connection->state == CONNECTION_ABORTING)
        return;
    connection->wants_output = true;
    connection->progress_ns = network_now_ns();
    lws_callback_on_writable(connection->wsi);
}

void connection_pause(struct connection *connection, bool is_paused)
{
    if (connection->is_paused == is_paused || connection->state != CONNECTION_OPEN)
        return;
    connection->is_paused = is_paused;
    lws_rx_flow_control(connection->wsi, is_paused ? 0 : 1);
}

void connection_finish(struct connection *connection)
{
    if (connection->state != CONNECTION_OPEN)
        return;
    connection->state = CONNECTION_FINISHING;
    connection->wants_output = false;
    connection_want_output(connection);
}

void connection_abort(struct connection *connection)
{
    connection->state = CONNECTION_ABORTING;
    lws_set_timeout(connection->wsi, PENDING_TIMEOUT_USER_OK, LWS_TO_KILL_ASYNC);
}

static void check_time(struct network *network)
{
    uint64_t now = network_now_ns(), stall = (uint64_t)network->params.stall_seconds * 1000000000ull;
    for (struct connection *connection = network->connections; connection; connection = connection->next) {
        bool is_stalled = connection->wants_output && now - connection->progress_ns > stall;
        bool has_lingered =
            connection->state == CONNECTION_LINGERING && now - connection->progress_ns > LINGER_NS;
        if (is_stalled)
            log_line(LOG_LEVEL_INFO, "a client took nothing for %u s and is disconnected",
                     network->params.stall_seconds);
        if (connection->state != CONNECTION_ABORTING && (is_stalled || has_lingered))
            connection_abort(connection);
    }
}

/* ---- libwebsockets ------------------------------------------------------------------------------------ */

static int on_session(struct lws *wsi, enum lws_callback_reasons reason, void *data, void *bytes, size_t size)
{
    (void)data;
    struct connection *connection;
    switch (reason) {
    case LWS_CALLBACK_RAW_RX:
        connection = lws_get_opaque_user_data(wsi);
        if (connection && connection->state == CONNECTION_OPEN)
            connection->network->params.callbacks.received(connection->session, bytes, size);
        return connection && connection->state == CONNECTION_ABORTING ? -1 : 0;
    case LWS_CALLBACK_RAW_WRITEABLE:
        connection = lws_get_opaque_user_data(wsi);
        return connection ? write_output(connection) : 0;
    case LWS_CALLBACK_RAW_CLOSE:
        connection = lws_get_opaque_user_data(wsi);
        lws_set_opaque_user_data(wsi, NULL);
        if (connection)
            forget(connection);
        return 0;
    default:
        return 0;
    }
}

static int on_listener(struct lws *wsi, enum lws_callback_reasons reason, void *data, void *bytes,
                       size_t size)
{
    (void)data;
    (void)bytes;
    (void)size;
    struct network *network = lws_context_user(lws_get_context(wsi));
    switch (reason) {
    case LWS_CALLBACK_RAW_RX_FILE:
        accept_clients(network, (int)(intptr_t)lws_get_opaque_user_data(wsi));
        return 0;
    case LWS_CALLBACK_EVENT_WAIT_CANCELLED:
        network->params.callbacks.woken(network->params.user);
        return 0;
    default:
        return 0;
    }
}

static const struct lws_protocols protocols[] = {{.name = "caustic-listener", .callback = on_listener},
                                                 {.name = "caustic-session",
                                                  .callback = on_session,
                                                  .rx_buffer_size = 16384,
                                                  .tx_packet_size = NETWORK_MAX_WRITE},
                                                 {0}};

static void on_tick(lws_sorted_usec_list_t *list)
{
    struct network *network = lws_container_of(list, struct network, tick);
    check_time(network);
    network->params.callbacks.ticked(network->params.user);
    lws_sul_schedule(network->context, 0, &network->tick, on_tick, NETWORK_TICK_MS * LWS_US_PER_MS);
}

static void on_lws_log(int level, const char *line)
{
    size_t length = strcspn(line, "\n");
    log_line(level & LLL_ERR ? LOG_LEVEL_ERROR : LOG_LEVEL_DEBUG, "libwebsockets: %.*s", (int)length, line);
}

struct network *network_create(const struct network_params *params, struct error *error)
{
    struct network *network = calloc(1, sizeof *network);
    if (!network) {
        error_set(error, STATUS_MEMORY, "out of memory for the network");
        return NULL;
    }
    network->params = *params;
    network->spare_descriptor = open("/dev/null", O_RDONLY | O_CLOEXEC);
    lws_set_log_level(LLL_ERR | LLL_WARN, on_lws_log);
    struct lws_context_creation_info info = {
        .port = CONTEXT_PORT_NO_LISTEN_SERVER,
        .options = LWS_SERVER_OPTION_EXPLICIT_VHOSTS | LWS_SERVER_OPTION_SKIP_SERVER_CANONICAL_NAME,
        .fd_limit_per_thread = params->max_connections + SPARE_DESCRIPTORS,
        .user = network,
        .gid = (__typeof__(((struct lws_context_creation_info *)0)->gid))-1, /* signed or not, by version */
        .uid = (__typeof__(((struct lws_context_creation_info *)0)->uid))-1};
    network->context = lws_create_context(&info);
    info.protocols = protocols;
    info.vhost_name = "causticd";
    network->vhost = network->context ? lws_create_vhost(network->context, &info) : NULL;
    if (!network->vhost) {
        error_set(error, STATUS_IO, "libwebsockets could not start its event loop");
        network_destroy(&network);
        return NULL;
    }
    lws_sul_schedule(network->context, 0, &network->tick, on_tick, NETWORK_TICK_MS * LWS_US_PER_MS);
    return network;
}

void network_destroy(struct network **network)
{
    if (!*network)
        return;
    if ((*network)->context) {
        /* lws_sul_cancel came with 4.1; Ubuntu 22.04 has 4.0 */
        lws_sul_schedule((*network)->context, 0, &(*network)->tick, on_tick, LWS_SET_TIMER_USEC_CANCEL);
        lws_context_destroy((*network)->context);
    }
    if ((*network)->spare_descriptor >= 0)
        close((*network)->spare_descriptor);
    free(*network);
    *network = NULL;
}

bool network_listen(struct network *network, struct listener *listener, struct error *error)
{
    lws_sock_file_fd_type descriptor = {.filefd = listener->fd};
    struct lws *wsi = lws_adopt_descriptor_vhost(network->vhost, LWS_ADOPT_RAW_FILE_DESC, descriptor,
                                                 "caustic-listener", NULL);
    int fd = listener->fd;
    listener->fd = -1;
    if (!wsi)
        return error_set(error, STATUS_IO, "cannot serve %s: out of descriptors", listener->address);
    lws_set_opaque_user_data(wsi, (void *)(intptr_t)fd);
    network->listeners[network->listener_count++] = wsi;
    return true;
}

void network_stop_listening(struct network *network)
{
    for (uint32_t i = 0; i < network->listener_count; i++)
        lws_set_timeout(network->listeners[i], PENDING_TIMEOUT_USER_OK, LWS_TO_KILL_ASYNC);
    network->listener_count = 0;
}

void network_run(struct network *network)
{
    while (!network->is_stopped && lws_service(network->context, 0) >= 0) {
    }
}

void network_stop(struct network *network)
{
    network->is_stopped = true;
    lws_cancel_service(network->context);
}

void network_wake(struct network *network)
{
    lws_cancel_service(network->context);
}
