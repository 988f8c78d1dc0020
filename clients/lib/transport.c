#include "transport.h"

#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

int64_t transport_now_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* 1: ready; 0: the deadline has passed. */
static int wait_for(int socket, short events, int64_t deadline_ms)
{
    for (;;) {
        int64_t left = deadline_ms - transport_now_ms();
        if (left < 0)
            left = 0;
        struct pollfd poll_socket = {.fd = socket, .events = events};
        int ready = poll(&poll_socket, 1, left > 60000 ? 60000 : (int)left);
        if (ready > 0)
            return 1;
        if (ready < 0 && errno != EINTR)
            return 1; /* the read or write that follows meets the error and names it */
        if (ready == 0 && left <= 60000)
            return 0;
    }
}

bool transport_wait(int socket, int64_t deadline_ms)
{
    return wait_for(socket, POLLIN, deadline_ms) == 1;
}

bool transport_set_nonblocking(int socket, struct error *error)
{
    int flags = fcntl(socket, F_GETFL);
    if (flags < 0 || fcntl(socket, F_SETFL, flags | O_NONBLOCK) < 0)
        return error_set(error, STATUS_IO, "socket: %s", strerror(errno));
    return true;
}

/* A connected socket, or -1 with errno. */
static int connect_to(const struct sockaddr *address, socklen_t size, int64_t deadline_ms)
{
    int client = socket(address->sa_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (client < 0)
        return -1;
    if (connect(client, address, size) < 0) {
        int failure = errno;
        if (failure == EINPROGRESS) {
            socklen_t length = sizeof failure;
            if (!wait_for(client, POLLOUT, deadline_ms))
                failure = ETIMEDOUT;
            else if (getsockopt(client, SOL_SOCKET, SO_ERROR, &failure, &length) < 0)
                failure = errno;
        }
        if (failure) {
            close(client);
            errno = failure;
            return -1;
        }
    }
    if (address->sa_family != AF_UNIX) {
        int on = 1; /* requests are small and wait for replies: Nagle's delay would be all of the latency */
        setsockopt(client, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    }
    return client;
}

static int connect_unix(const char *path, int64_t deadline_ms, struct error *error)
{
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    if (path[0] == 0 || strlen(path) >= sizeof address.sun_path) {
        error_set(error, STATUS_INVALID, "unix:%s: the path must have 1 to %zu bytes", path,
                  sizeof address.sun_path - 1);
        errno = 0;
        return -1;
    }
    memcpy(address.sun_path, path, strlen(path) + 1);
    int client = connect_to((struct sockaddr *)&address, sizeof address, deadline_ms);
    if (client < 0)
        error_set(error, STATUS_IO, "unix:%s: %s; is causticd running?", path, strerror(errno));
    return client;
}

/* errno is 0 when trying again cannot help. */
static int connect_tcp(const char *host_and_port, int64_t deadline_ms, struct error *error)
{
    char host[256];
    const char *colon = strrchr(host_and_port, ':');
    size_t length = colon ? (size_t)(colon - host_and_port) : 0;
    const char *start = host_and_port;
    if (length >= 2 && start[0] == '[' && start[length - 1] == ']') {
        start++;
        length -= 2;
    }
    if (length == 0 || length >= sizeof host || colon[1] == 0) {
        error_set(error, STATUS_INVALID, "tcp:%s: write tcp:HOST:PORT, as in tcp:127.0.0.1:7420",
                  host_and_port);
        errno = 0;
        return -1;
    }
    memcpy(host, start, length);
    host[length] = 0;
    struct addrinfo hints = {.ai_socktype = SOCK_STREAM, .ai_flags = AI_NUMERICSERV}, *list = NULL;
    int failure = getaddrinfo(host, colon + 1, &hints, &list);
    if (failure) {
        error_set(error, STATUS_NOT_FOUND, "tcp:%s: %s", host_and_port, gai_strerror(failure));
        errno = 0;
        return -1;
    }
    int client = -1;
    for (struct addrinfo *entry = list; entry && client < 0; entry = entry->ai_next)
        client = connect_to(entry->ai_addr, entry->ai_addrlen, deadline_ms);
    if (client < 0) {
        int reason = errno;
        error_set(error, STATUS_IO, "tcp:%s: %s; is causticd running?", host_and_port, strerror(reason));
        errno = reason;
    }
    freeaddrinfo(list);
    return client;
}

int transport_connect(const char *address, int64_t deadline_ms, int64_t wait_until_ms, struct error *error)
{
    for (;;) {
        int client = -1;
        errno = 0;
        if (strncmp(address, "tcp:", 4) == 0) {
            client = connect_tcp(address + 4, deadline_ms, error);
        } else if (strncmp(address, "unix:", 5) == 0) {
            client = connect_unix(address + 5, deadline_ms, error);
        } else {
            error_set(error, STATUS_INVALID, "%s: an address begins with tcp: or unix:", address);
            return -1;
        }
        bool nobody_listens = errno == ECONNREFUSED || errno == ENOENT || errno == EAGAIN;
        if (client >= 0 || !nobody_listens || transport_now_ms() >= wait_until_ms)
            return client;
        poll(NULL, 0, 50);
    }
}

bool transport_read(int socket, void *bytes, size_t size, int64_t deadline_ms, struct error *error)
{
    uint8_t *target = bytes;
    while (size > 0) {
        ssize_t got = recv(socket, target, size, 0);
        if (got > 0) {
            target += got;
            size -= (size_t)got;
        } else if (got == 0) {
            return error_set(error, STATUS_IO, "the server closed the connection");
        } else if (errno == EAGAIN || errno == EWOULDBLOCK) {
            if (!wait_for(socket, POLLIN, deadline_ms))
                return error_set(error, STATUS_IO, "no answer from the server in time");
        } else if (errno != EINTR) {
            return error_set(error, STATUS_IO, "reading from the server: %s", strerror(errno));
        }
    }
    return true;
}

bool transport_write(int socket, const void *bytes, size_t size, int64_t deadline_ms, struct error *error)
{
    const uint8_t *source = bytes;
    while (size > 0) {
        ssize_t sent = send(socket, source, size, MSG_NOSIGNAL);
        if (sent >= 0) {
            source += sent;
            size -= (size_t)sent;
        } else if (errno == EAGAIN || errno == EWOULDBLOCK) {
            if (!wait_for(socket, POLLOUT, deadline_ms))
                return error_set(error, STATUS_IO, "the server takes no requests");
        } else if (errno != EINTR) {
            return error_set(error, STATUS_IO, "writing to the server: %s", strerror(errno));
        }
    }
    return true;
}
