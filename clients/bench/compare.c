#include "compare.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static bool is_same_point(const struct bench_result *a, const struct bench_result *b)
{
    if (strcmp(a->scene, b->scene) != 0 || a->width != b->width || a->height != b->height ||
        a->time != b->time || a->setting_count != b->setting_count)
        return false;
    for (uint32_t i = 0; i < a->setting_count; i++) {
        const char *other = bench_result_setting(b, a->settings[i].name);
        if (!other || strcmp(other, a->settings[i].value) != 0)
            return false;
    }
    return true;
}

/* after / before, with both lifted to the least that counts. */
static double ratio(double before, double after, double least)
{
    double low = fmax(before, least), high = fmax(after, least);
    return low == high ? 1 : high / low;
}

static void judge(struct bench_change *change, const struct bench_result *before,
                  const struct bench_result *after, const struct bench_thresholds *thresholds)
{
    for (uint32_t i = 0; i < METRIC_COUNT; i++) {
        double old = metric_error((enum metric)i, before->measures[i].median);
        double new = metric_error((enum metric)i, after->measures[i].median);
        change->errors[i] = NAN;
        if (isnan(old) || isnan(new))
            continue;
        change->errors[i] = ratio(old, new, metric_floor((enum metric)i));
        change->is_error_worse[i] = change->errors[i] > 1 + thresholds->error;
        change->is_worse |= change->is_error_worse[i];
        change->is_better |= change->errors[i] < 1 / (1 + thresholds->error);
    }
    change->gpu = ratio(before->gpu_ns.median, after->gpu_ns.median, 1);
    change->is_gpu_worse = change->gpu > 1 + thresholds->time;
    change->is_worse |= change->is_gpu_worse;
    change->is_better |= change->gpu < 1 / (1 + thresholds->time);
    change->has_other_reference = strcmp(before->reference, after->reference) != 0;
}

bool bench_compare(const struct bench_results *before, const struct bench_results *after,
                   const struct bench_thresholds *thresholds, struct bench_comparison *comparison,
                   struct error *error)
{
    memset(comparison, 0, sizeof *comparison);
    comparison->changes = calloc(after->count + 1, sizeof *comparison->changes);
    if (!comparison->changes)
        return error_set(error, STATUS_MEMORY, "no memory to compare %u points", after->count);
    for (uint32_t i = 0; i < after->count; i++) {
        uint32_t partner = 0;
        while (partner < before->count && !is_same_point(&before->results[partner], &after->results[i]))
            partner++;
        if (partner == before->count) {
            comparison->only_after++;
            continue;
        }
        struct bench_change *change = &comparison->changes[comparison->count++];
        change->before = partner;
        change->after = i;
        judge(change, &before->results[partner], &after->results[i], thresholds);
        comparison->worse += change->is_worse;
        comparison->better += change->is_better;
    }
    for (uint32_t i = 0; i < before->count; i++) {
        uint32_t partner = 0;
        while (partner < after->count && !is_same_point(&before->results[i], &after->results[partner]))
            partner++;
        comparison->only_before += partner == after->count;
    }
    return true;
}

void bench_comparison_print(const struct bench_comparison *comparison, const struct bench_results *before,
                            const struct bench_results *after, FILE *stream)
{
    uint32_t others = 0;
    for (uint32_t i = 0; i < comparison->count; i++) {
        const struct bench_change *change = &comparison->changes[i];
        const struct bench_result *old = &before->results[change->before];
        const struct bench_result *new = &after->results[change->after];
        others += change->has_other_reference;
        if (!change->is_worse && !change->is_better)
            continue;
        char name[600];
        bench_result_name(new, NULL, name, sizeof name);
        fprintf(stream, "%-6s %s%s%s\n",
                change->is_worse && change->is_better ? "mixed"
                : change->is_worse                    ? "worse"
                                                      : "better",
                new->scene, *name ? " " : "", name);
        for (uint32_t k = 0; k < METRIC_COUNT; k++)
            if (!isnan(change->errors[k]) && change->errors[k] != 1)
                fprintf(stream, "         %-10s %.4g -> %.4g  (x %.3f)%s\n", metric_names[k],
                        metric_error((enum metric)k, old->measures[k].median),
                        metric_error((enum metric)k, new->measures[k].median), change->errors[k],
                        change->is_error_worse[k] ? "  worse" : "");
        fprintf(stream, "         %-10s %.4g -> %.4g ms  (x %.3f)%s\n", "gpu time", old->gpu_ns.median * 1e-6,
                new->gpu_ns.median * 1e-6, change->gpu, change->is_gpu_worse ? "  worse" : "");
    }
    fprintf(stream, "%u points in both runs: %u worse, %u better", comparison->count, comparison->worse,
            comparison->better);
    if (comparison->only_before || comparison->only_after)
        fprintf(stream, "; %u only in the earlier run, %u only in this one", comparison->only_before,
                comparison->only_after);
    fputc('\n', stream);
    if (strcmp(before->server.device, after->server.device) != 0)
        fprintf(stream, "the earlier run was on another device (%s): times do not compare\n",
                before->server.device);
    if (others)
        fprintf(stream, "%u points were compared with another reference than in the earlier run\n", others);
}
