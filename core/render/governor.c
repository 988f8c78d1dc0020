#include "governor.h"

#include <math.h>

/* Frames off to the same side after another that make a trend, which is followed faster. */
#define TREND 3u
/* Frames that are not measured at the start: their pipelines are compiled, and densities are the seed's. */
#define SKIPPED_FRAMES 2u
/* Frames at the start and after a jump whose steps may be of any size. */
#define FREE_FRAMES 12u
/* A frame that took so many times what was predicted, or so many times less, is a hitch; two in a row are
 * another picture, whose line goes through them at the old share. */
#define FAR 1.25
/* Share of the photons' passes that grows with them until the fit has seen budgets that differ: too high a
 * guess only makes steps smaller. */
#define FIRST_SHARE 0.95
/* Share of a frame that has to grow with photons for steps to be free: below it other work is what changed.
 */
#define FREE_SHARE 0.4
/* Of the target: what a frame may change of what the host is thought to take. A host that other programs hold
 * up for some frames is nothing that fewer photons would mend. */
#define HOST_STEP 0.01
/* Densities emit less than this share of a budget only where nothing in view wants photons. */
#define FULL 0.5
/* Photons that are worth more than camera rays or samples, as a share of the most; frames that have to agree
 * on fewer of these, and on more. */
#define SCARCE      (1.0 / 8)
#define FEWER_AFTER 3
#define MORE_AFTER  8
/* Steps of photons that say what share of the time grows with them; how little a step without noise says,
 * squared; weight that earlier steps keep. */
#define LEAST_STEP 0.02
#define DOUBT      0.01
#define FORGET     0.85
#define FOLLOW     0.4 /* weight of the newest frame in the line and `rest_ns` */

static const double knob_factors[GOVERNOR_KNOBS] = {[GOVERNOR_RAYS] = 3, [GOVERNOR_SAMPLES] = 4};

static double clamp(double value, double least, double most)
{
    return fmin(fmax(value, least), most);
}

/* What the photons' passes take, and what share of it grows with photons. */
static double line_at(const struct governor *governor, double photons)
{
    return governor->fixed_ns + governor->slope_ns * photons;
}

static double share_at(const struct governor *governor, double photons)
{
    return governor->slope_ns * photons / line_at(governor, photons);
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
    return fmax(time - governor->host_ns - governor->rest_ns - governor->fixed_ns, 0) /
           (governor->slope_ns * governor->fill);
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
    governor->free_frames = FREE_FRAMES;
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

/* A line through this point of which `share` grows with photons. */
static void set_line(struct governor *governor, double photons, double time, double share)
{
    share = clamp(share, 0.05, 0.98);
    governor->slope_ns = share * time / photons;
    governor->fixed_ns = (1 - share) * time;
}

/* From frames whose photons differ: a camera path changes their times as well, but less from one to the next.
 */
static void fit(struct governor *governor, double photons, double time)
{
    double step = log(photons / governor->last_photons), change = log(time / governor->last_ns);
    governor->last_photons = photons;
    governor->last_ns = time;
    if (fabs(step) < LEAST_STEP)
        return;
    double share = share_at(governor, photons);
    governor->weight = FORGET * governor->weight + step * step;
    double doubt = DOUBT + 4 * governor->noise * governor->noise;
    share += step * (change - share * step) / (governor->weight + doubt);
    set_line(governor, photons, line_at(governor, photons), share);
}

static void start(struct governor *governor, double photons, double time, double rest, double host,
                  double share)
{
    set_line(governor, photons, time, share);
    governor->rest_ns = rest;
    governor->host_ns = host;
    governor->weight = 0;
    governor->last_photons = photons;
    governor->last_ns = time;
    governor->free_frames = FREE_FRAMES;
}

/* Whether the frame says something about those to come; it is part of the line then. */
static bool learn(struct governor *governor, const struct governor_frame *frame)
{
    double photons = frame->emitted,
           device = clamp(frame->device_ns, 0.01 * frame->measured_ns, frame->measured_ns),
           time = clamp(frame->photons_ns, 0.01 * device, device), rest = device - time,
           host = frame->measured_ns - device;
    if (governor->frames++ < SKIPPED_FRAMES)
        return false;
    double off = 0;
    if (!(governor->slope_ns > 0)) {
        start(governor, photons, time, rest, host, FIRST_SHARE);
    } else {
        off = log(device / (governor->rest_ns + line_at(governor, photons)));
        bool is_far = fabs(off) > fmax(log(FAR), 4 * governor->noise);
        /* Neighbours that differ are noise; those that are off together are a path. */
        governor->noise += 0.1 * (fmin(0.75 * fabs(off - governor->off), 1) - governor->noise);
        governor->trend = off * governor->off > 0 ? governor->trend + 1 : 0;
        governor->off = off;
        if (is_far && !governor->was_far) {
            governor->was_far = true;
            return false;
        }
        governor->was_far = false;
        if (is_far) {
            start(governor, photons, time, rest, host, share_at(governor, photons));
            return true;
        }
    }
    fit(governor, photons, time);
    /* Where frames of the same work differ by much, more of them have to agree. */
    double follow = (governor->trend >= TREND ? 2 * FOLLOW : FOLLOW) / fmax(1, 20 * governor->noise);
    double factor = 1 + follow * (time / line_at(governor, photons) - 1);
    governor->fixed_ns *= factor;
    governor->slope_ns *= factor;
    governor->rest_ns += follow * (rest - governor->rest_ns);
    double host_step = governor->free_frames > 0 ? frame->target_ns : HOST_STEP * frame->target_ns;
    governor->host_ns += clamp(FOLLOW * (host - governor->host_ns), -host_step, host_step);
    return true;
}

bool governor_step(struct governor *governor, const struct governor_frame *frame)
{
    double budget = governor_photons(governor, frame->least, frame->most);
    if (governor->target_ns != frame->target_ns) {
        governor->target_ns = frame->target_ns;
        governor->free_frames = FREE_FRAMES;
    }
    if (!(frame->emitted > 0) || !(frame->measured_ns > 0))
        return false;
    governor->since_change++;
    governor->free_frames -= governor->free_frames > 0;
    if (!(governor->fill > 0))
        governor->fill = 1;
    /* Densities follow a larger budget over a few frames. */
    bool is_settled = governor->since_change > 3;
    if (is_settled && frame->emitted < FULL * budget && frame->measured_ns < frame->target_ns) {
        governor->is_idle = true;
        return false;
    }
    if (governor->is_idle) { /* densities grow again */
        governor->is_idle = false;
        governor->since_change = 0;
    } else if (is_settled)
        governor->fill += 0.3 * (clamp(frame->emitted / budget, FULL, 1) - governor->fill);
    if (!learn(governor, frame))
        return false;
    if (steer_counts(governor, frame))
        return true;
    double band = fmax(frame->is_at_rest ? GOVERNOR_REST_BAND : GOVERNOR_BAND, 0.75 * governor->noise);
    double expected = governor->host_ns + governor->rest_ns + line_at(governor, governor->fill * budget);
    if (fabs(expected / frame->target_ns - 1) <= band)
        return false;
    double ratio = clamp(photons_of(governor, frame->target_ns), frame->least, frame->most) / budget;
    bool is_free =
        governor->free_frames > 0 && governor->slope_ns * frame->emitted > FREE_SHARE * frame->measured_ns;
    if (!is_free) {
        double far = governor->noise < GOVERNOR_BAND ? pow(fmax(ratio, 1 / ratio), 0.25) : 1;
        double most = fmax(GOVERNOR_STEP, far);
        ratio = clamp(ratio, 1 / most, most);
    }
    governor->photons = clamp(budget * ratio, frame->least, frame->most);
    if (fabs(governor->photons - budget) < 1)
        return false;
    governor->since_change = 0;
    return true;
}
