/* bench_reference.h: the picture that points are compared with.
 *
 * Made by the server's accumulate mode, aa=pixel and density=uniform: many jittered frames, every photon in
 * the one pixel that sees it. Two halves with seeds of their own grow until what they differ by says that
 * their mean is within `confidence` (relative L1) of the truth, or the photons are spent. Kept on disk under
 * a hash of scene, camera, time, size, settings and server version. Or a given file.
 */
#ifndef CAUSTIC_BENCH_REFERENCE_H
#define CAUSTIC_BENCH_REFERENCE_H

#include "session.h"

struct bench_reference {
    struct bench_reference_note note;
    float *values;   /* 3 components */
    double exposure; /* stops, for showing it */
};

/* STATUS_INVALID when a given file has another size. */
bool bench_reference_get(struct session *session, struct bench_reference *reference, struct error *error);
void bench_reference_free(struct bench_reference *reference);

/* Any picture that core/image/picture.h reads, of an EXR the layer "caustics" when there is one. free() it.
 * NULL on error. Written are the planes R, G and B of an EXR. */
float *bench_image_read(const char *path, uint32_t *width, uint32_t *height, struct error *error);
bool bench_image_write(const char *path, const float *values, uint32_t width, uint32_t height,
                       struct error *error);

#endif
