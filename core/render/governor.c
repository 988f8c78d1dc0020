#include "governor.h"

#include <math.h>

/* Frames that are not measured at the start: their pipelines are compiled, and densities are the seed's. */
#define SKIPPED_FRAMES 2u
/* Steps at the start and after a jump that may be of any size. */
#define FREE_STEPS 6u
/* A frame that took so many times what was predicted, or so many times less, is a hitch; two in a row are
 * another picture, whose line goes through them at the old share. */
#define FAR 1.25
/* Share of the time that goes into photons until the fit has seen budgets that differ: too high a guess only
 * makes steps smaller. */
#define FIRST_SHARE 0.95
/* Photons that are worth more than camera rays or samples, as a share of the most; frames that have to agree
 * on fewer of these, and on more. */
#define SCARCE      (1.0 / 8)
#define FEWER_AFTER 3
#define MORE_AFTER  8
#define FORGET      0.85 /* weight of the frame before in the fit */
#define FOLLOW      0.4  /* weight of the newest frame in `scale` */

static const double knob_factors[GOVERNOR_KNOBS] = {[GOVERNOR_RAYS] = 3, [GOVERNOR_SAMPLES] = 4};

static double clamp(double value, double least, double most)
{
    return fmin(fmax(value, least), most);
}

static double predict(const struct governor *governor, double photons)
{
    return governor->scale * (governor->fixed_ns + governor->slope_ns * photons);
}

uint32_t governor_photons(struct governor *governor, double least, double most)
{
    if (!(governor->photons > 0))
        governor->photons = sqrt(least * most);
    governor->photons = clamp(governor->photons, least, most);
    return (uint32_t)governor->photons;
}

uint32_t governor_count(struct governor *governor, enum governor_knob knob, double most)
{
    double *count = &governor->counts[knob];
    *count = *count > 0 ? clamp(floor(*count), 1, most) : most;
    return (uint32_t)*count;
}

/* Photons that fill `time`. */
static double photons_of(const struct governor *governor, double time)
{
    return fmax(time / governor->scale - governor->fixed_ns, 0) / (governor->slope_ns * governor->fill);
}

static bool steer_count(struct governor *governor, const struct governor_frame *frame,
                        enum governor_knob knob)
{
    double most = frame->knobs[knob].most;
    if (!(most > 1))
        return false;
    double count = governor_count(governor, knob, most), factor = knob_factors[knob];
    double more = fmin(factor * count, most), cost = (more / count - 1) * frame->knobs[knob].spent_ns;
    double scarce = fmax(frame->least, SCARCE * frame->most);
    bool wants_fewer = count > 1 && photons_of(governor, frame->target_ns) < scarce;
    bool wants_more = more > count && photons_of(governor, frame->target_ns - cost) > 2 * scarce;
    int32_t *votes = &governor->votes[knob];
    *votes = wants_fewer ? (*votes > 0 ? *votes : 0) + 1 : wants_more ? (*votes < 0 ? *votes : 0) - 1 : 0;
    bool is_fewer = *votes >= FEWER_AFTER, is_more = *votes <= -MORE_AFTER;
    if (!is_fewer && !is_more)
        return false;
    governor->counts[knob] = is_fewer ? fmax(floor(count / factor), 1) : more;
    governor->free_steps = FREE_STEPS;
    /* What the others would do has to be asked again. */
    for (int i = 0; i < GOVERNOR_KNOBS; i++)
        governor->votes[i] = 0;
    return true;
}

static bool steer_counts(struct governor *governor, const struct governor_frame *frame)
{
    bool rays_first = frame->knobs[GOVERNOR_RAYS].spent_ns >= frame->knobs[GOVERNOR_SAMPLES].spent_ns;
    enum governor_knob first = rays_first ? GOVERNOR_RAYS : GOVERNOR_SAMPLES,
                       second = rays_first ? GOVERNOR_SAMPLES : GOVERNOR_RAYS;
    return steer_count(governor, frame, first) || steer_count(governor, frame, second);
}

static void fit(struct governor *governor, double photons, double time)
{
    double share = FIRST_SHARE;
    if (governor->weight > 0)
        share = governor->slope_ns * governor->sum_p / governor->sum_t;
    governor->weight = governor->weight * FORGET + 1;
    governor->sum_p = governor->sum_p * FORGET + photons;
    governor->sum_t = governor->sum_t * FORGET + time;
    governor->sum_pp = governor->sum_pp * FORGET + photons * photons;
    governor->sum_pt = governor->sum_pt * FORGET + photons * time;
    double p = governor->sum_p / governor->weight, t = governor->sum_t / governor->weight;
    double variance = governor->sum_pp / governor->weight - p * p;
    /* A slope from budgets that hardly differ is the slope of the noise: the share stays then. */
    if (variance > 0.01 * p * p)
        share = (governor->sum_pt / governor->weight - p * t) / variance * p / t;
    share = clamp(share, 0.3, 0.98);
    governor->slope_ns = share * t / p;
    governor->fixed_ns = (1 - share) * t;
}

/* Whether the frame says something about those to come; it is part of the line then. */
static bool learn(struct governor *governor, double photons, double time)
{
    if (governor->frames++ < SKIPPED_FRAMES)
        return false;
    if (!(governor->slope_ns > 0)) {
        governor->scale = 1;
        governor->free_steps = FREE_STEPS;
    } else {
        double ratio = time / predict(governor, photons);
        double off = fabs(log(ratio));
        bool is_far = off > fmax(log(FAR), 3 * governor->noise);
        governor->noise += 0.1 * (fmin(off, 1) - governor->noise);
        if (is_far && !governor->was_far) {
            governor->was_far = true;
            return false;
        }
        governor->was_far = false;
        if (is_far) {
            double share = governor->slope_ns * governor->sum_p / governor->sum_t;
            governor->weight = 1;
            governor->sum_p = photons;
            governor->sum_t = time;
            governor->sum_pp = photons * photons;
            governor->sum_pt = photons * time;
            governor->slope_ns = share * time / photons;
            governor->fixed_ns = (1 - share) * time;
            governor->scale = 1;
            governor->free_steps = FREE_STEPS;
            return true;
        }
    }
    fit(governor, photons, time);
    double ratio = time / (governor->fixed_ns + governor->slope_ns * photons);
    /* Where frames of the same work differ by much, more of them have to agree. */
    governor->scale += FOLLOW / fmax(1, 20 * governor->noise) * (ratio - governor->scale);
    return true;
}

bool governor_step(struct governor *governor, const struct governor_frame *frame)
{
    double budget = governor_photons(governor, frame->least, frame->most);
    if (governor->target_ns != frame->target_ns) {
        governor->target_ns = frame->target_ns;
        governor->free_steps = FREE_STEPS;
    }
    if (!(frame->emitted > 0) || !(frame->measured_ns > 0))
        return false;
    governor->since_change++;
    if (!(governor->fill > 0))
        governor->fill = 1;
    /* Densities follow a larger budget over a few frames. */
    if (governor->since_change > 3)
        governor->fill += 0.3 * (clamp(frame->emitted / budget, 0.1, 1) - governor->fill);
    if (!learn(governor, frame->emitted, frame->measured_ns))
        return false;
    if (steer_counts(governor, frame))
        return true;
    double band = fmax(frame->is_at_rest ? GOVERNOR_REST_BAND : GOVERNOR_BAND, 0.75 * governor->noise);
    if (fabs(predict(governor, governor->fill * budget) / frame->target_ns - 1) <= band)
        return false;
    double ratio = photons_of(governor, frame->target_ns) / budget;
    if (governor->free_steps > 0)
        governor->free_steps--;
    else
        ratio = clamp(ratio, 1 / GOVERNOR_STEP, GOVERNOR_STEP);
    governor->photons = clamp(budget * ratio, frame->least, frame->most);
    if (fabs(governor->photons - budget) < 1)
        return false;
    governor->since_change = 0;
    return true;
}
