/* governor.h: how many photons, camera rays where what glass shows breaks up, and samples of multisampled
 * splats a frame may have so that it takes the time it was given.
 *
 * The photons' own passes take fixed_ns + slope_ns * photons, other passes rest_ns and the host host_ns, and
 * all of them change along a camera path. What share of the photons' time grows with them is learnt from
 * frames whose budgets differ. The governor asks that line for the photons of the target time, and stays
 * where it is while the line is within a dead band of the target: a budget that changes all the time would be
 * seen as pumping. Steps are free only where photons are much of the frame; elsewhere other work is what
 * changed, and photons follow it slowly. The host's part is followed slowest. A picture in which nothing
 * wants photons leaves the budget as it is. Where less than an eighth of the photons would be left, camera
 * rays go first, by thirds, or samples, by quarters, whichever takes more of the time; they come back when
 * twice that would be left with them. It knows nothing of views or devices. Zero initialises it.
 */
#ifndef CAUSTIC_GOVERNOR_H
#define CAUSTIC_GOVERNOR_H

#include <stdbool.h>
#include <stdint.h>

#define GOVERNOR_BAND      0.05 /* of the target: nothing is changed within it */
#define GOVERNOR_REST_BAND 0.10 /* and of a view at rest, whose picture would change with the photons */
/* Most that the budget is multiplied or divided by in a frame, but at jumps; or the fourth root of how far it
 * has to go. */
#define GOVERNOR_STEP 1.25

/* What gives way before photons do. */
enum governor_knob { GOVERNOR_RAYS, GOVERNOR_SAMPLES, GOVERNOR_KNOBS };

struct governor {
    double target_ns;
    double photons;               /* the budget it chose; 0: none yet */
    double fill;                  /* share of the budget that is emitted once densities have followed it */
    double fixed_ns;              /* of the line that the photons' passes follow, */
    double slope_ns;              /* per photon; 0: nothing measured yet */
    double rest_ns;               /* of the latest frames, what other passes took, */
    double host_ns;               /* and the host */
    double weight;                /* fading sum of the squared steps that the line is fitted to */
    double last_photons, last_ns; /* of the last frame it was fitted to */
    double off;                   /* log of what the last frame took over what was predicted */
    double noise;    /* mean of how far it is from that of the frame before, as it would be without a trend */
    uint32_t trend;  /* frames in a row that were off to the side of the one before */
    uint32_t frames; /* measured */
    uint32_t since_change;         /* frames the budget has been as it is */
    uint32_t free_frames;          /* frames whose step is not limited */
    double counts[GOVERNOR_KNOBS]; /* of a pixel, that it chose; 0: none yet */
    int32_t votes[GOVERNOR_KNOBS]; /* frames in a row that speak for fewer; negative: for more */
    bool is_idle;                  /* the last frames had nothing in view that wants photons */
    bool was_far;                  /* the last frame took a time that the line does not explain */
};

struct governor_frame {
    double measured_ns, target_ns;
    double device_ns;   /* of the measured time, what all passes took */
    double photons_ns;  /* and those whose work grows with photons */
    double emitted;     /* photons of the measured frame */
    double least, most; /* budget that may be chosen */
    struct {
        double most;     /* of a pixel, that may be chosen; at most 1: there is nothing to choose */
        double spent_ns; /* of the measured time, what grows with them, at most in proportion */
    } knobs[GOVERNOR_KNOBS];
    bool is_at_rest;
};

/* The budget for the next frame. The first one, before anything is measured, is the geometric mean of both
 * limits. */
uint32_t governor_photons(struct governor *governor, double least, double most);
/* And its camera rays or samples: at first all of them. */
uint32_t governor_count(struct governor *governor, enum governor_knob knob, double most);
/* Takes in a frame that was measured; true when the budget or a count changed. */
bool governor_step(struct governor *governor, const struct governor_frame *frame);

#endif
