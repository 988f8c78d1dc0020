#define _GNU_SOURCE
#include "listener.h"

#include <arpa/inet.h>
#include <errno.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#define LISTENER_BACKLOG 64

struct parsed_address {
    bool is_unix;
    char host[128], port[8], path[108];
};

static bool parse(struct parsed_address *parsed, const char *address, struct error *error)
{
    memset(parsed, 0, sizeof *parsed);
    if (strncmp(address, "unix:", 5) == 0) {
        parsed->is_unix = true;
        size_t length = strlen(address + 5);
        if (length == 0)
            return error_set(error, STATUS_INVALID, "the address \"%s\" has no path: write unix:PATH",
                             address);
        if (length >= sizeof parsed->path)
            return error_set(error, STATUS_INVALID,
                             "the path of \"%.200s\" has %zu bytes, a socket path may have %zu at most",
                             address, length, sizeof parsed->path - 1);
        memcpy(parsed->path, address + 5, length + 1);
        return true;
    }
    const char *host = address + 4, *port = strrchr(address, ':');
    if (strncmp(address, "tcp:", 4) != 0 || port <= host)
        return error_set(error, STATUS_INVALID,
                         "the address \"%.200s\" is neither tcp:HOST:PORT nor unix:PATH", address);
    size_t length = (size_t)(port - host);
    port++;
    if (host[0] == '[' && host[length - 1] == ']') {
        host++;
        length -= 2;
    }
    if (length == 0 || length >= sizeof parsed->host)
        return error_set(error, STATUS_INVALID, "the host of \"%.200s\" is empty or too long", address);
    memcpy(parsed->host, host, length);
    char *end;
    unsigned long number = strtoul(port, &end, 10);
    if (*port < '0' || *port > '9' || *end || number > 65535)
        return error_set(error, STATUS_INVALID, "the port of \"%.200s\" must be a number from 0 to 65535",
                         address);
    snprintf(parsed->port, sizeof parsed->port, "%lu", number);
    return true;
}

bool listener_check(const char *address, struct error *error)
{
    struct parsed_address parsed;
    return parse(&parsed, address, error);
}

static bool is_loopback(const struct sockaddr *address)
{
    if (address->sa_family == AF_INET)
        return ntohl(((const struct sockaddr_in *)(const void *)address)->sin_addr.s_addr) >> 24 == 127;
    return address->sa_family == AF_INET6 &&
           IN6_IS_ADDR_LOOPBACK(&((const struct sockaddr_in6 *)(const void *)address)->sin6_addr);
}

static bool open_tcp(struct listener *listener, const struct parsed_address *parsed, const char *address,
                     bool allow_remote, struct error *error)
{
    struct addrinfo hints = {.ai_socktype = SOCK_STREAM, .ai_flags = AI_PASSIVE | AI_NUMERICSERV},
                    *found = NULL;
    int code = getaddrinfo(parsed->host, parsed->port, &hints, &found);
    if (code)
        return error_set(error, STATUS_NOT_FOUND, "cannot listen on %s: %s", address, gai_strerror(code));
    bool ok = false;
    listener->is_remote = !is_loopback(found->ai_addr);
    if (listener->is_remote && !allow_remote) {
        error_set(error, STATUS_INVALID,
                  "%s can be reached from other machines and the protocol has no authentication: listen on "
                  "127.0.0.1 or a UNIX socket, or add --allow-remote",
                  address);
        goto done;
    }
    listener->fd = socket(found->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    int yes = 1;
    if (listener->fd < 0 || setsockopt(listener->fd, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes) != 0 ||
        bind(listener->fd, found->ai_addr, found->ai_addrlen) != 0 ||
        listen(listener->fd, LISTENER_BACKLOG) != 0) {
        error_set(error, STATUS_IO, "cannot listen on %s: %s", address,
                  errno == EADDRINUSE ? "the port is in use by another process" : strerror(errno));
        goto done;
    }
    struct sockaddr_storage bound;
    socklen_t size = sizeof bound;
    char host[INET6_ADDRSTRLEN], port[8];
    if (getsockname(listener->fd, (struct sockaddr *)&bound, &size) != 0 ||
        getnameinfo((struct sockaddr *)&bound, size, host, sizeof host, port, sizeof port,
                    NI_NUMERICHOST | NI_NUMERICSERV) != 0) {
        error_set(error, STATUS_IO, "cannot read back the address of %s: %s", address, strerror(errno));
        goto done;
    }
    const char *format = bound.ss_family == AF_INET6 ? "tcp:[%s]:%s" : "tcp:%s:%s";
    snprintf(listener->address, sizeof listener->address, format, host, port);
    ok = true;
done:
    freeaddrinfo(found);
    return ok;
}

/* A socket file stays behind when its server was killed. Nobody listening is what tells it from one in use.
 */
static bool remove_stale(const struct sockaddr_un *name, struct error *error)
{
    struct stat file;
    if (lstat(name->sun_path, &file) != 0)
        return true;
    if (!S_ISSOCK(file.st_mode))
        return error_set(error, STATUS_INVALID,
                         "cannot listen on unix:%s: the file exists and is not a socket", name->sun_path);
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (fd < 0)
        return error_set(error, STATUS_IO, "cannot open a socket: %s", strerror(errno));
    int connected = connect(fd, (const struct sockaddr *)name, sizeof *name);
    int reason = errno;
    close(fd);
    if (connected == 0 || reason != ECONNREFUSED)
        return error_set(error, STATUS_IO, "cannot listen on unix:%s: %s", name->sun_path,
                         connected == 0 || reason == EAGAIN ? "another process listens on it"
                                                            : strerror(reason));
    if (unlink(name->sun_path) != 0)
        return error_set(error, STATUS_IO, "cannot replace the stale socket %s: %s", name->sun_path,
                         strerror(errno));
    return true;
}

static bool open_unix(struct listener *listener, const struct parsed_address *parsed, struct error *error)
{
    struct sockaddr_un name = {.sun_family = AF_UNIX};
    memcpy(name.sun_path, parsed->path, sizeof name.sun_path);
    if (!remove_stale(&name, error))
        return false;
    listener->fd = socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    struct stat file;
    mode_t mask = umask(0177);
    int bound = listener->fd < 0 ? -1 : bind(listener->fd, (const struct sockaddr *)&name, sizeof name);
    umask(mask);
    if (bound != 0 || lstat(parsed->path, &file) != 0 || listen(listener->fd, LISTENER_BACKLOG) != 0)
        return error_set(error, STATUS_IO, "cannot listen on unix:%s: %s", parsed->path, strerror(errno));
    memcpy(listener->path, parsed->path, sizeof listener->path);
    listener->device = file.st_dev;
    listener->inode = file.st_ino;
    snprintf(listener->address, sizeof listener->address, "unix:%s", parsed->path);
    return true;
}

bool listener_open(struct listener *listener, const char *address, bool allow_remote, struct error *error)
{
    *listener = (struct listener){.fd = -1};
    struct parsed_address parsed;
    bool ok = parse(&parsed, address, error) &&
              (parsed.is_unix ? open_unix(listener, &parsed, error)
                              : open_tcp(listener, &parsed, address, allow_remote, error));
    if (!ok)
        listener_close(listener);
    return ok;
}

void listener_close(struct listener *listener)
{
    if (listener->fd >= 0)
        close(listener->fd);
    listener->fd = -1;
    struct stat file;
    if (listener->path[0] && lstat(listener->path, &file) == 0 && file.st_dev == listener->device &&
        file.st_ino == listener->inode)
        unlink(listener->path);
    listener->path[0] = 0;
}
