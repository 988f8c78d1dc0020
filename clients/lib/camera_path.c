#include "camera_path.h"

#include <errno.h>
#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define NUMBERS        10u /* of a camera: eye, at, up, fov */
#define MAX_FILE_BYTES ((size_t)16 << 20)

enum key_place { PLACE_TIME, PLACE_FRAME, PLACE_EVEN };

struct key {
    double place;
    float numbers[NUMBERS];
};

struct camera_path {
    enum key_place place;
    bool is_linear;
    uint32_t count;
    struct key *keys;
};

/* ---- reading ------------------------------------------------------------------------------------------ */

struct reader {
    const char *file;
    size_t key;
    struct error *error;
};

static bool refuse(const struct reader *reader, const char *field, const char *text)
{
    return error_set(reader->error, STATUS_INVALID, "%s: keys[%zu].%s %s", reader->file, reader->key, field,
                     text);
}

static bool read_number(const struct reader *reader, json_t *object, const char *field, double *value)
{
    json_t *number = json_object_get(object, field);
    if (!json_is_number(number) || !isfinite(json_number_value(number)))
        return refuse(reader, field, "must be a number");
    *value = json_number_value(number);
    return true;
}

static bool read_vector(const struct reader *reader, json_t *object, const char *field, float *values)
{
    json_t *array = json_object_get(object, field);
    if (!array)
        return refuse(reader, field, "is missing");
    for (size_t i = 0; i < 3; i++) {
        json_t *number = json_array_get(array, i);
        if (json_array_size(array) != 3 || !json_is_number(number) ||
            !isfinite((float)json_number_value(number)))
            return refuse(reader, field, "must be three numbers");
        values[i] = (float)json_number_value(number);
    }
    return true;
}

static bool check_fields(const struct reader *reader, json_t *object)
{
    static const char *const known[] = {"time", "frame", "eye", "at", "up", "fov"};
    const char *name;
    json_t *value;
    json_object_foreach(object, name, value)
    {
        bool is_known = false;
        for (size_t i = 0; i < sizeof known / sizeof *known; i++)
            is_known |= strcmp(name, known[i]) == 0;
        if (!is_known)
            return error_set(reader->error, STATUS_INVALID,
                             "%s: keys[%zu] has a field %.60s; there are time, frame, eye, at, up, fov",
                             reader->file, reader->key, name);
    }
    return true;
}

static bool read_key(const struct reader *reader, json_t *object, float fov, struct camera_path *path)
{
    if (!json_is_object(object))
        return error_set(reader->error, STATUS_INVALID, "%s: keys[%zu] must be an object", reader->file,
                         reader->key);
    if (!check_fields(reader, object))
        return false;
    bool has_time = json_object_get(object, "time"), has_frame = json_object_get(object, "frame");
    enum key_place place = has_time ? PLACE_TIME : has_frame ? PLACE_FRAME : PLACE_EVEN;
    if (has_time && has_frame)
        return refuse(reader, "frame", "and time exclude each other");
    if (reader->key > 0 && place != path->place)
        return refuse(reader, has_time ? "time" : "frame", "must be given in every key or in none");
    path->place = place;

    struct key *key = &path->keys[reader->key];
    key->place = (double)reader->key;
    if (place != PLACE_EVEN && !read_number(reader, object, has_time ? "time" : "frame", &key->place))
        return false;
    if (reader->key > 0 && key->place <= key[-1].place)
        return refuse(reader, has_time ? "time" : "frame", "must be later than that of the key before");
    float *numbers = key->numbers;
    numbers[7] = 1; /* up */
    numbers[9] = fov;
    if (!read_vector(reader, object, "eye", numbers) || !read_vector(reader, object, "at", numbers + 3))
        return false;
    if (json_object_get(object, "up") && !read_vector(reader, object, "up", numbers + 6))
        return false;
    if (json_object_get(object, "fov")) {
        double value;
        if (!read_number(reader, object, "fov", &value))
            return false;
        numbers[9] = (float)value;
    }
    if (!(numbers[9] > 0 && numbers[9] < 179))
        return refuse(reader, "fov", "must be above 0 and below 179 degrees");
    if (memcmp(numbers, numbers + 3, 3 * sizeof *numbers) == 0)
        return refuse(reader, "at", "must differ from eye");
    return true;
}

struct camera_path *camera_path_parse(const char *text, const char *file, float fov, struct error *error)
{
    json_error_t fault;
    struct camera_path *path = NULL;
    json_t *root = json_loads(text, JSON_REJECT_DUPLICATES, &fault);
    if (!root) {
        error_set(error, STATUS_INVALID, "%s: line %d: %s", file, fault.line, fault.text);
        return NULL;
    }
    json_t *keys = json_object_get(root, "keys");
    size_t count = json_array_size(keys);
    json_t *interpolation = json_object_get(root, "interpolation");
    const char *kind = interpolation ? json_string_value(interpolation) : "catmull-rom";
    if (count == 0) {
        error_set(error, STATUS_INVALID,
                  "%s: needs \"keys\": [ { \"eye\": [x, y, z], \"at\": [x, y, z] }, ... ]", file);
        goto done;
    }
    if (count > CAMERA_PATH_MAX_KEYS) {
        error_set(error, STATUS_LIMIT, "%s: %zu keys are more than %u", file, count, CAMERA_PATH_MAX_KEYS);
        goto done;
    }
    if (!kind || (strcmp(kind, "linear") != 0 && strcmp(kind, "catmull-rom") != 0)) {
        error_set(error, STATUS_INVALID, "%s: interpolation must be \"catmull-rom\" or \"linear\"", file);
        goto done;
    }
    path = calloc(1, sizeof *path);
    if (path)
        path->keys = calloc(count, sizeof *path->keys);
    if (!path || !path->keys) {
        error_set(error, STATUS_MEMORY, "%s: no memory for %zu keys", file, count);
        camera_path_destroy(&path);
        goto done;
    }
    path->is_linear = strcmp(kind, "linear") == 0;
    path->count = (uint32_t)count;
    for (size_t i = 0; i < count; i++) {
        struct reader reader = {.file = file, .key = i, .error = error};
        if (!read_key(&reader, json_array_get(keys, i), fov > 0 ? fov : 45, path)) {
            camera_path_destroy(&path);
            break;
        }
    }
done:
    json_decref(root);
    return path;
}

struct camera_path *camera_path_read(const char *file, float fov, struct error *error)
{
    struct camera_path *path = NULL;
    FILE *stream = fopen(file, "rb");
    if (!stream) {
        error_set(error, errno == ENOENT ? STATUS_NOT_FOUND : STATUS_IO, "%s: %s", file, strerror(errno));
        return NULL;
    }
    char *text = malloc(MAX_FILE_BYTES + 1);
    size_t size = text ? fread(text, 1, MAX_FILE_BYTES + 1, stream) : 0;
    if (!text) {
        error_set(error, STATUS_MEMORY, "%s: no memory to read it", file);
    } else if (ferror(stream)) {
        error_set(error, STATUS_IO, "%s: cannot be read", file);
    } else if (size > MAX_FILE_BYTES) {
        error_set(error, STATUS_LIMIT, "%s: larger than %zu bytes", file, MAX_FILE_BYTES);
    } else {
        text[size] = 0;
        path = camera_path_parse(text, file, fov, error);
    }
    free(text);
    fclose(stream);
    return path;
}

void camera_path_destroy(struct camera_path **path)
{
    if (*path) {
        free((*path)->keys);
        free(*path);
    }
    *path = NULL;
}

/* ---- evaluation --------------------------------------------------------------------------------------- */

/* Slope at key `i` of number `n`, per unit of place. */
static double slope(const struct camera_path *path, uint32_t i, uint32_t n)
{
    const struct key *before = &path->keys[i > 0 ? i - 1 : i];
    const struct key *after = &path->keys[i + 1 < path->count ? i + 1 : i];
    return ((double)after->numbers[n] - before->numbers[n]) / (after->place - before->place);
}

struct protocol_camera camera_path_at(const struct camera_path *path, uint32_t frame, uint32_t frame_count,
                                      double time)
{
    double place = path->place == PLACE_TIME ? time : frame;
    if (path->place == PLACE_EVEN)
        place = frame_count > 1 ? (double)frame * (path->count - 1) / (frame_count - 1) : 0;
    uint32_t low = 0, high = path->count;
    while (high - low > 1) {
        uint32_t middle = low + (high - low) / 2;
        if (path->keys[middle].place <= place)
            low = middle;
        else
            high = middle;
    }
    float numbers[NUMBERS];
    memcpy(numbers, path->keys[low].numbers, sizeof numbers);
    if (high < path->count && place > path->keys[low].place) {
        const struct key *from = &path->keys[low], *to = &path->keys[high];
        double span = to->place - from->place, s = (place - from->place) / span;
        for (uint32_t n = 0; n < NUMBERS; n++) {
            double a = from->numbers[n], b = to->numbers[n], value = a + (b - a) * s;
            if (!path->is_linear) {
                /* The line plus what the slopes at both ends differ from it (cubic Hermite). */
                double a_slope = slope(path, low, n) * span - (b - a),
                       b_slope = slope(path, high, n) * span - (b - a);
                value += s * (1 - s) * ((1 - s) * a_slope - s * b_slope);
            }
            numbers[n] = (float)value;
        }
    }
    struct protocol_camera camera = {.fov = numbers[9]};
    memcpy(camera.eye, numbers, sizeof camera.eye);
    memcpy(camera.at, numbers + 3, sizeof camera.at);
    memcpy(camera.up, numbers + 6, sizeof camera.up);
    return camera;
}
