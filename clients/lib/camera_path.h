/* camera_path.h: a camera that moves through keyframes read from a JSON file.
 *
 *     {
 *       "interpolation": "catmull-rom",     or "linear"; catmull-rom when absent
 *       "keys": [
 *         { "time": 0,   "eye": [0, 1, 4], "at": [0, 0, 0], "up": [0, 1, 0], "fov": 40 },
 *         { "time": 2.5, "eye": [2, 1, 3], "at": [0, 0, 0] }
 *       ]
 *     }
 *
 * A key says its place by "time" in seconds or by "frame", a number of the recording from 0; all keys the
 * same way, and rising. Keys that say neither are spread evenly over the recording. "up" is [0, 1, 0] when
 * absent, "fov" (vertical, degrees) the caller's. Before the first key and after the last the camera stands
 * still. Between them every number is interpolated by itself: linearly, or by the cubic through the keys
 * whose slope at a key is that of the line between its neighbours (Catmull-Rom, for keys at any distance in
 * time), at the ends that of the first and last line.
 */
#ifndef CAUSTIC_CAMERA_PATH_H
#define CAUSTIC_CAMERA_PATH_H

#include "../../protocol/protocol.h"

#define CAMERA_PATH_MAX_KEYS 65536u

struct camera_path;

/* `fov` 0: 45. Errors name the file, the key and the field. */
struct camera_path *camera_path_read(const char *file, float fov, struct error *error);
struct camera_path *camera_path_parse(const char *text, const char *file, float fov, struct error *error);
void camera_path_destroy(struct camera_path **path);

/* The camera of frame `frame` of `frame_count`, which shows the time `time`. */
struct protocol_camera camera_path_at(const struct camera_path *path, uint32_t frame, uint32_t frame_count,
                                      double time);

#endif
