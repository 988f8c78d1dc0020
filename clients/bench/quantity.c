#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "results.h"

/* ---- quantities ------------------------------------------------------------------------------------------
 */

static double statistic(const struct bench_result *result, const char *name)
{
    for (uint32_t i = 0; i < result->statistic_count; i++)
        if (strcmp(result->statistics[i].name, name) == 0)
            return result->statistics[i].value;
    return NAN;
}

/* The sum of passes, in ms: names with '+', or all for NULL. */
static double pass_sum(const struct bench_result *result, const char *names)
{
    double sum = 0;
    uint32_t found = 0;
    for (uint32_t i = 0; i < result->pass_count; i++) {
        size_t length = strlen(result->passes_ns[i].name);
        bool is_named = names == NULL;
        for (const char *at = names; at && !is_named; at = strchr(at, '+') ? strchr(at, '+') + 1 : NULL)
            is_named = strcspn(at, "+") == length && strncmp(at, result->passes_ns[i].name, length) == 0;
        if (is_named) {
            sum += result->passes_ns[i].value * 1e-6;
            found++;
        }
    }
    return found ? sum : NAN;
}

static double term(const struct bench_result *result, const char *name)
{
    if (strcmp(name, "gpu_ms") == 0)
        return result->gpu_ns.median * 1e-6;
    if (strcmp(name, "wall_ms") == 0)
        return result->wall_ns.median * 1e-6;
    if (strcmp(name, "frame_ms") == 0)
        return result->frame_ns.median * 1e-6;
    if (strcmp(name, "passes_ms") == 0)
        return pass_sum(result, NULL);
    if (strncmp(name, "pass.", 5) == 0)
        return pass_sum(result, name + 5);
    if (strcmp(name, "rays") == 0)
        return statistic(result, "rays_traced");
    if (strcmp(name, "memory_mib") == 0)
        return statistic(result, "device_bytes") / 0x1p20;
    for (uint32_t i = 0; i < METRIC_COUNT; i++)
        if (strcmp(name, metric_names[i]) == 0)
            return metric_error((enum metric)i, result->measures[i].median);
    /* What was emitted, not the budget of the setting that has the same name. */
    if (strcmp(name, "photons") == 0)
        return statistic(result, "photons_emitted");
    const char *text = bench_result_setting(result, name);
    char *end = NULL;
    double value = text ? strtod(text, &end) : NAN;
    if (end && (end == text || *end))
        value = NAN;
    return text ? value : statistic(result, name);
}

double bench_quantity(const struct bench_result *result, const char *expression)
{
    char text[160], *parts[2] = {NULL, NULL};
    size_t used = 0;
    for (const char *at = expression; *at && used + 1 < sizeof text; at++)
        if (*at != ' ')
            text[used++] = *at;
    text[used] = 0;
    bool is_rest = strncmp(text, "1-", 2) == 0;
    parts[0] = text + (is_rest ? 2 : 0);
    parts[1] = strchr(parts[0], '/');
    if (parts[1])
        *parts[1]++ = 0;
    double value = term(result, parts[0]);
    if (parts[1])
        value /= term(result, parts[1]);
    return is_rest ? 1 - value : value;
}

/* ---- fronts ----------------------------------------------------------------------------------------------
 */

static bool is_beaten(const double *costs, const double *errors, uint32_t count, uint32_t i)
{
    for (uint32_t k = 0; k < count; k++) {
        bool is_as_good = costs[k] <= costs[i] && errors[k] <= errors[i];
        bool is_better = costs[k] < costs[i] || errors[k] < errors[i];
        if (is_as_good && (is_better || k < i))
            return true;
    }
    return false;
}

uint32_t bench_front(const double *costs, const double *errors, uint32_t count, uint32_t *order)
{
    uint32_t found = 0;
    for (uint32_t i = 0; i < count; i++) {
        if (!isfinite(costs[i]) || !isfinite(errors[i]) || is_beaten(costs, errors, count, i))
            continue;
        uint32_t at = found++;
        for (; at > 0 && costs[order[at - 1]] > costs[i]; at--)
            order[at] = order[at - 1];
        order[at] = i;
    }
    return found;
}

uint32_t bench_best_within(const double *costs, const double *errors, uint32_t count, double budget)
{
    uint32_t best = UINT32_MAX;
    for (uint32_t i = 0; i < count; i++)
        if (isfinite(errors[i]) && costs[i] <= budget &&
            (best == UINT32_MAX || errors[i] < errors[best] ||
             (errors[i] == errors[best] && costs[i] < costs[best])))
            best = i;
    return best;
}
