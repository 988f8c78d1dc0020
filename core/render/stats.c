#include "stats.h"

const struct stat_info stat_infos[STAT_COUNT] = {
#define S(name, unit, help) {#name, unit, help},
    STATS(S)
#undef S
};
