#include "options.h"

#include "protocol/protocol.h"

#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char help[] =
    "Usage: causticd [SCENE] [OPTION...]\n"
    "Renders caustics of a scene for clients that connect over a socket.\n"
    "\n"
    "SCENE is a built-in scene or a .gltf or .glb file; default: sphere.\n"
    "\n"
    "Where clients connect\n"
    "  --listen ADDRESS       tcp:HOST:PORT or unix:PATH; may be repeated. Port 0 picks a free\n"
    "                         port, which the line \"causticd: ready on ...\" tells.\n"
    "                         Default: tcp:127.0.0.1:7420\n"
    "  --allow-remote         permit TCP addresses that other machines can reach. There is no\n"
    "                         authentication: whoever can connect can use the server.\n"
    "  --ready-file PATH      written when the server is ready: one address per line\n"
    "\n"
    "What renders\n"
    "  --device NAME|INDEX    Vulkan device by part of its name or by its number\n"
    "  --list-devices         print the Vulkan devices and exit\n"
    "  --tracer auto|bvh|khr  own ray tracer or the device's ray queries; auto takes khr on\n"
    "                         hardware ray tracing and bvh elsewhere\n"
    "  --cache DIR            folder of the pipeline cache; default: causticd/ in the user's\n"
    "                         cache folder\n"
    "  --validation           run under the Vulkan validation layer\n"
    "\n"
    "Limits\n"
    "  --max-clients N        connections at a time, 1 to 1024; default 32\n"
    "  --max-views N          views of one connection, 1 to 256; default 8\n"
    "  --size-limit WxH       most pixels of a view; default: what the device allows\n"
    "  --output-limit MIB     unsent bytes of one client after which the server stops rendering\n"
    "                         and reading for it, 1 to 65536; default 256\n"
    "  --stall-timeout S      disconnect a client that takes nothing for so long, 1 to 86400;\n"
    "                         default 30\n"
    "  --message-timeout S    disconnect a client whose handshake or half message takes longer,\n"
    "                         1 to 86400; default 10\n"
    "\n"
    "  --log-level LEVEL      error, warning, info (default) or debug\n"
    "  --version              print the version and exit\n"
    "  --help                 print this and exit\n"
    "\n"
    "SIGTERM and SIGINT finish the frame in flight, send what is waiting for up to 2 seconds and\n"
    "exit with 0; a second signal exits at once with 1.\n"
    "\n"
    "Exit status: 0 ended on request, 1 failure, 2 wrong usage.\n"
    "\n"
    "Examples\n"
    "  causticd                                   the sphere on tcp:127.0.0.1:7420\n"
    "  causticd square --listen unix:/tmp/c.sock  a wine glass, through a UNIX socket\n"
    "  causticd room.glb --device nvidia          a file, on a certain device\n"
    "\n"
    "Record from it with caustic-record; PROTOCOL.md says how to write a client.\n";

enum {
    OPTION_LISTEN = 256,
    OPTION_ALLOW_REMOTE,
    OPTION_READY_FILE,
    OPTION_DEVICE,
    OPTION_LIST_DEVICES,
    OPTION_TRACER,
    OPTION_CACHE,
    OPTION_VALIDATION,
    OPTION_MAX_CLIENTS,
    OPTION_MAX_VIEWS,
    OPTION_SIZE_LIMIT,
    OPTION_OUTPUT_LIMIT,
    OPTION_STALL_TIMEOUT,
    OPTION_MESSAGE_TIMEOUT,
    OPTION_LOG_LEVEL,
    OPTION_VERSION,
    OPTION_HELP
};

static const struct option long_options[] = {
    {"listen", required_argument, NULL, OPTION_LISTEN},
    {"allow-remote", no_argument, NULL, OPTION_ALLOW_REMOTE},
    {"ready-file", required_argument, NULL, OPTION_READY_FILE},
    {"device", required_argument, NULL, OPTION_DEVICE},
    {"list-devices", no_argument, NULL, OPTION_LIST_DEVICES},
    {"tracer", required_argument, NULL, OPTION_TRACER},
    {"cache", required_argument, NULL, OPTION_CACHE},
    {"validation", no_argument, NULL, OPTION_VALIDATION},
    {"max-clients", required_argument, NULL, OPTION_MAX_CLIENTS},
    {"max-views", required_argument, NULL, OPTION_MAX_VIEWS},
    {"size-limit", required_argument, NULL, OPTION_SIZE_LIMIT},
    {"output-limit", required_argument, NULL, OPTION_OUTPUT_LIMIT},
    {"stall-timeout", required_argument, NULL, OPTION_STALL_TIMEOUT},
    {"message-timeout", required_argument, NULL, OPTION_MESSAGE_TIMEOUT},
    {"log-level", required_argument, NULL, OPTION_LOG_LEVEL},
    {"version", no_argument, NULL, OPTION_VERSION},
    {"help", no_argument, NULL, OPTION_HELP},
    {0}};

static bool read_number(const char *option, const char *text, uint32_t minimum, uint32_t maximum,
                        uint32_t *number)
{
    char *end;
    unsigned long value = strtoul(text, &end, 10);
    if (*text < '0' || *text > '9' || *end || value < minimum || value > maximum) {
        fprintf(stderr, "causticd: --%s must be a number from %u to %u, not \"%s\"\n", option, minimum,
                maximum, text);
        return false;
    }
    *number = (uint32_t)value;
    return true;
}

/* The index of `text` in a NULL-terminated list of words. */
static bool read_word(const char *option, const char *text, const char *const *words, unsigned *index)
{
    for (unsigned i = 0; words[i]; i++)
        if (strcmp(text, words[i]) == 0) {
            *index = i;
            return true;
        }
    fprintf(stderr, "causticd: --%s must be one of", option);
    for (unsigned i = 0; words[i]; i++)
        fprintf(stderr, "%s %s", i ? "," : "", words[i]);
    fprintf(stderr, ", not \"%s\"\n", text);
    return false;
}

static bool read_size(const char *text, uint32_t *pixels)
{
    char *end;
    unsigned long width = strtoul(text, &end, 10), height = 0;
    bool ok = *text >= '0' && *text <= '9' && *end == 'x';
    if (ok) {
        const char *second = end + 1;
        height = strtoul(second, &end, 10);
        ok = *second >= '0' && *second <= '9' && !*end;
    }
    ok = ok && width >= 1 && height >= 1 && width <= VIEW_MAX_SIZE && height <= VIEW_MAX_SIZE &&
         width * height <= VIEW_MAX_PIXELS;
    if (!ok) {
        fprintf(stderr,
                "causticd: --size-limit must be WIDTHxHEIGHT, at most %u along a side and %u pixels, not "
                "\"%s\"\n",
                VIEW_MAX_SIZE, VIEW_MAX_PIXELS, text);
        return false;
    }
    *pixels = (uint32_t)(width * height);
    return true;
}

static bool read_option(struct options *options, int code, const char *text)
{
    static const char *const tracers[] = {"auto", "bvh", "khr", NULL};
    static const char *const levels[] = {"error", "warning", "info", "debug", NULL};
    struct error error;
    uint32_t number = 0;
    unsigned index = 0;
    bool ok = true;
    switch (code) {
    case OPTION_LISTEN:
        if (options->listen_count == LISTENER_MAX_COUNT) {
            fprintf(stderr, "causticd: --listen may be given %d times at most\n", LISTENER_MAX_COUNT);
            return false;
        }
        if (!listener_check(text, &error)) {
            fprintf(stderr, "causticd: --listen: %s\n", error.message);
            return false;
        }
        options->listen[options->listen_count++] = text;
        break;
    case OPTION_ALLOW_REMOTE:
        options->allow_remote = true;
        break;
    case OPTION_READY_FILE:
        options->ready_file = text;
        break;
    case OPTION_DEVICE:
        options->device = text;
        break;
    case OPTION_LIST_DEVICES:
        options->list_devices = true;
        break;
    case OPTION_TRACER:
        ok = read_word("tracer", text, tracers, &index);
        options->tracer = (enum tracer)index;
        break;
    case OPTION_CACHE:
        options->cache_dir = text;
        break;
    case OPTION_VALIDATION:
        options->validation = true;
        break;
    case OPTION_MAX_CLIENTS:
        ok = read_number("max-clients", text, 1, 1024, &options->max_clients);
        break;
    case OPTION_MAX_VIEWS:
        ok = read_number("max-views", text, 1, 256, &options->max_views);
        break;
    case OPTION_SIZE_LIMIT:
        ok = read_size(text, &options->size_limit);
        break;
    case OPTION_OUTPUT_LIMIT:
        ok = read_number("output-limit", text, 1, 65536, &number);
        options->output_limit = (uint64_t)number << 20;
        break;
    case OPTION_STALL_TIMEOUT:
        ok = read_number("stall-timeout", text, 1, 86400, &options->stall_seconds);
        break;
    case OPTION_MESSAGE_TIMEOUT:
        ok = read_number("message-timeout", text, 1, 86400, &options->message_seconds);
        break;
    case OPTION_LOG_LEVEL:
        ok = read_word("log-level", text, levels, &index);
        options->log_level = (enum log_level)index;
        break;
    default:
        ok = false;
    }
    return ok;
}

enum options_outcome options_read(struct options *options, int argc, char **argv)
{
    *options = (struct options){.max_clients = 32,
                                .max_views = 8,
                                .output_limit = 256ull << 20,
                                .stall_seconds = 30,
                                .message_seconds = 10,
                                .log_level = LOG_LEVEL_INFO};
    opterr = 0;
    for (;;) {
        int code = getopt_long(argc, argv, ":", long_options, NULL);
        if (code == -1)
            break;
        if (code == OPTION_HELP) {
            fputs(help, stdout);
            return OPTIONS_DONE;
        }
        if (code == OPTION_VERSION) {
            printf("causticd %s, protocol %u.%u\n", CAUSTICD_VERSION, PROTOCOL_MAJOR, PROTOCOL_MINOR);
            return OPTIONS_DONE;
        }
        if (code == ':' || code == '?') {
            const char *given = argv[optind - 1];
            fprintf(stderr,
                    code == ':' ? "causticd: %s needs a value; see causticd --help\n"
                                : "causticd: unknown or ambiguous option %s; see causticd --help\n",
                    given);
            return OPTIONS_WRONG;
        }
        if (!read_option(options, code, optarg))
            return OPTIONS_WRONG;
    }
    if (argc - optind > 1) {
        fprintf(stderr, "causticd: one scene at a time: \"%s\" and \"%s\" were given\n", argv[optind],
                argv[optind + 1]);
        return OPTIONS_WRONG;
    }
    options->scene = optind < argc ? argv[optind] : "sphere";
    if (!options->listen_count)
        options->listen[options->listen_count++] = "tcp:127.0.0.1:7420";
    return OPTIONS_RUN;
}
