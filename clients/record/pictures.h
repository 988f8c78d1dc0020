/* pictures.h: a frame as files: EXR with all its channels, PNG to look at. */
#ifndef CAUSTIC_RECORD_PICTURES_H
#define CAUSTIC_RECORD_PICTURES_H

#include "../lib/client.h"

/* A name and a value for the EXR header. */
struct picture_note {
    char name[64], text[64];
};

struct pictures {
    const struct protocol_hello *hello;
    const char *folder;
    const struct picture_note *notes; /* settings of the view, as name and value */
    uint32_t note_count;
    double seed;
    bool png;
    bool has_exposure; /* set by the first frame that is not black, unless given */
    double exposure;   /* stops */
    char file[32];     /* name of the last frame's EXR; empty when it had no pixels */
};

/* frame_NUMBER.exr, and density_NUMBER.exr and variance_NUMBER.exr when those were asked for;
 * frame_NUMBER.png with `png`. Files are whole or absent. */
bool pictures_write(struct pictures *pictures, const struct client_frame *frame, uint32_t number,
                    struct error *error);

#endif
