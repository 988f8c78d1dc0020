#include "session.h"

#include <errno.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "../lib/progress.h"

#define REQUEST_MS 30000u /* most time for anything but a frame */

uint64_t bench_hash(uint64_t hash, const void *bytes, size_t size)
{
    const unsigned char *at = bytes;
    for (size_t i = 0; i < size; i++)
        hash = (hash ^ at[i]) * 0x100000001b3u;
    return hash;
}

void bench_hash_text(uint64_t hash, char text[20])
{
    snprintf(text, 20, "%016llx", (unsigned long long)hash);
}

static bool hash_file(const char *path, uint64_t *hash, struct error *error)
{
    unsigned char block[65536];
    FILE *file = fopen(path, "rb");
    if (!file)
        return error_set(error, errno == ENOENT ? STATUS_NOT_FOUND : STATUS_IO, "%.300s: %s", path,
                         strerror(errno));
    for (size_t size; (size = fread(block, 1, sizeof block, file)) > 0;)
        *hash = bench_hash(*hash, block, size);
    bool is_whole = ferror(file) == 0;
    fclose(file);
    return is_whole || error_set(error, STATUS_IO, "%.300s: cannot be read", path);
}

/* The buffers and pictures that a .gltf names; a .glb has them inside. Names it cannot make sense of are the
 * server's to refuse. */
static void hash_named_files(const char *path, uint64_t *hash)
{
    static const char *const lists[] = {"buffers", "images"};
    const char *slash = strrchr(path, '/');
    json_t *root = json_load_file(path, 0, NULL), *item;
    size_t index;
    for (size_t i = 0; root && i < 2; i++)
        json_array_foreach(json_object_get(root, lists[i]), index, item)
        {
            const char *uri = json_string_value(json_object_get(item, "uri"));
            char file[2 * BENCH_PATH];
            struct error ignored;
            if (!uri || strncmp(uri, "data:", 5) == 0)
                continue;
            snprintf(file, sizeof file, "%.*s%s", slash ? (int)(slash - path + 1) : 0, path, uri);
            (void)hash_file(file, hash, &ignored);
        }
    json_decref(root);
}

/* The server's program, as server_process finds it. */
static bool hash_program(const char *program, uint64_t *hash, struct error *error)
{
    char path[4096];
    if (program)
        return hash_file(program, hash, error);
    ssize_t length = readlink("/proc/self/exe", path, sizeof path - sizeof "causticd");
    if (length <= 0)
        return error_set(error, STATUS_IO, "/proc/self/exe: %s", strerror(errno));
    path[length] = 0;
    strcpy(strrchr(path, '/') + 1, "causticd");
    return hash_file(path, hash, error);
}

static bool identify_own(struct session *session, struct error *error)
{
    const char *source = session->scene->source;
    uint64_t build = BENCH_HASH_START;
    if (!hash_program(session->params->program, &build, error))
        return false;
    bench_hash_text(build, session->about.build);
    uint64_t content = BENCH_HASH_START;
    /* as the server tells files from built-in scenes */
    const char *ending = strrchr(source, '.');
    if (ending && (!strcasecmp(ending, ".gltf") || !strcasecmp(ending, ".glb"))) {
        if (!hash_file(source, &content, error))
            return false;
        hash_named_files(source, &content);
    } else {
        content = bench_hash(build, source, strlen(source));
    }
    bench_hash_text(content, session->content);
    return true;
}

static void identify_foreign(struct session *session)
{
    const struct protocol_hello *hello = session->hello;
    uint64_t hash = bench_hash(BENCH_HASH_START, hello->scene.bytes, hello->scene.length);
    hash = bench_hash(hash, &hello->triangles, sizeof hello->triangles);
    hash = bench_hash(hash, &hello->duration, sizeof hello->duration);
    for (uint32_t i = 0; i < hello->light_count; i++) {
        hash = bench_hash(hash, hello->lights[i].intensity, sizeof hello->lights[i].intensity);
        hash = bench_hash(hash, hello->lights[i].position, sizeof hello->lights[i].position);
        hash = bench_hash(hash, hello->lights[i].direction, sizeof hello->lights[i].direction);
    }
    bench_hash_text(hash, session->content);
}

bool session_explain(struct session *session, struct error *error, const char *prefix)
{
    struct error inner = *error;
    /* A server that dies closes its connections a moment before it has ended. */
    for (int i = 0; session->server && inner.status == STATUS_IO && i < 100; i++) {
        if (!server_process_is_alive(session->server, &inner))
            break;
        usleep(20000);
    }
    return error_set(error, inner.status, "%.150s: %.350s", prefix, inner.message);
}

/* ---- opening ---------------------------------------------------------------------------------------------
 */

static bool try_group(struct session *session, uint32_t view, const struct bench_group *group,
                      const char *what, struct error *error)
{
    char prefix[160];
    snprintf(prefix, sizeof prefix, "%s %s", what, group->name);
    return session_set(session, view, group->settings, group->count, error) ||
           session_explain(session, error, prefix);
}

static bool try_settings(struct session *session, struct error *error)
{
    const struct bench_config *config = session->params->config;
    uint32_t view;
    if (!session_view(session, &view, error))
        return false;
    for (uint32_t i = 0; i < config->method_count; i++)
        if (!try_group(session, view, &config->methods[i], "method", error))
            return false;
    for (uint32_t i = 0; i < config->axis_count; i++)
        for (uint32_t k = 0; k < config->axes[i].count; k++)
            if (!client_view_set(session->client, view, config->axes[i].name, config->axes[i].values[k],
                                 error))
                return session_explain(session, error, "settings");
    return try_group(session, view, &config->reference, "reference", error) &&
           client_view_destroy(session->client, view, error);
}

static bool describe(struct session *session, struct error *error)
{
    const struct protocol_hello *hello = session->hello;
    protocol_text_copy(hello->version, session->about.version, sizeof session->about.version);
    protocol_text_copy(hello->device, session->about.device, sizeof session->about.device);
    protocol_text_copy(hello->driver, session->about.driver, sizeof session->about.driver);
    protocol_text_copy(hello->tracer, session->about.tracer, sizeof session->about.tracer);
    if (!session->server)
        identify_foreign(session);
    return client_find_channel(session->client, "caustics", &session->caustics, error);
}

bool session_open(struct session *session, const struct session_params *params,
                  const struct bench_scene *scene, struct error *error)
{
    *session = (struct session){.params = params, .scene = scene};
    const char *address = params->address;
    if (!address) {
        if (!identify_own(session, error))
            return false;
        session->server = server_process_start(
            &(struct server_process_params){
                .program = params->program, .scene = scene->source, .arguments = params->server_arguments},
            error);
        if (!session->server)
            return false;
        address = server_process_address(session->server);
    }
    session->client = client_connect(&(struct client_params){.address = address,
                                                             .name = "caustic-bench " CAUSTIC_VERSION,
                                                             .timeout_ms = params->timeout_ms < REQUEST_MS
                                                                               ? params->timeout_ms
                                                                               : REQUEST_MS},
                                     error);
    if (!session->client)
        return false;
    session->hello = client_hello(session->client);
    return describe(session, error) && try_settings(session, error);
}

void session_close(struct session *session)
{
    struct error ignored;
    client_destroy(&session->client);
    server_process_stop(&session->server, &ignored);
}

/* ---- views and frames ------------------------------------------------------------------------------------
 */

bool session_view(struct session *session, uint32_t *view, struct error *error)
{
    const struct bench_config *config = session->params->config;
    const struct bench_scene *scene = session->scene;
    if (!client_view_create(session->client, config->width, config->height, view, error))
        return session_explain(session, error, "size");
    if (scene->camera_kind == BENCH_CAMERA_NAMED &&
        !client_view_follow(session->client, *view, scene->camera_name, error))
        return session_explain(session, error, "camera");
    if (scene->camera_kind == BENCH_CAMERA_FREE &&
        !client_view_camera(session->client, *view, &scene->camera, error))
        return session_explain(session, error, "camera");
    return scene->time == 0 || client_view_time(session->client, *view, scene->time, error) ||
           session_explain(session, error, "time");
}

bool session_set(struct session *session, uint32_t view, const struct option_setting *settings,
                 uint32_t count, struct error *error)
{
    for (uint32_t i = 0; i < count; i++)
        if (!client_view_set(session->client, view, settings[i].name, settings[i].value, error))
            return false;
    return true;
}

struct client_frame *session_render(struct session *session, uint32_t view, uint64_t *elapsed_ns,
                                    struct error *error)
{
    int64_t begin = progress_now_ns();
    struct client_frame *frame =
        client_render(session->client, view,
                      &(struct client_render_params){.channels = 1u << session->caustics,
                                                     .timeout_ms = session->params->timeout_ms},
                      error);
    if (elapsed_ns)
        *elapsed_ns = (uint64_t)(progress_now_ns() - begin);
    return frame;
}

double session_statistic(const struct session *session, const struct client_frame *frame, const char *name)
{
    for (uint32_t i = 0; i < session->hello->statistic_count && i < frame->info.statistic_count; i++)
        if (protocol_text_equals(session->hello->statistics[i].name, name))
            return frame->info.statistics[i];
    return NAN;
}
