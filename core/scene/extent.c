#include "extent.h"

#include <math.h>

#include "vec3.h"

struct box {
    double min[3], max[3];
};

static struct box box_of(const struct scene_mesh *mesh, const float world[12])
{
    struct box box = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
    for (int corner = 0; corner < 8; corner++)
        for (int row = 0; row < 3; row++) {
            double place = (double)world[4 * row + 3];
            for (int k = 0; k < 3; k++)
                place += (double)world[4 * row + k] *
                         (double)(corner >> k & 1 ? mesh->bounds_max[k] : mesh->bounds_min[k]);
            box.min[row] = fmin(box.min[row], place);
            box.max[row] = fmax(box.max[row], place);
        }
    return box;
}

static double half_size(const double min[3], const double max[3])
{
    return 0.5 * sqrt(pow(max[0] - min[0], 2) + pow(max[1] - min[1], 2) + pow(max[2] - min[2], 2));
}

static double farthest(const double min[3], const double max[3], const double origin[3])
{
    double most = 0;
    for (int k = 0; k < 3; k++)
        most = fmax(most, fmax(fabs(min[k] - origin[k]), fabs(max[k] - origin[k])));
    return most;
}

/* How coarse the caster is: rays leave its surface by a step, and its own coordinates are rounded. */
static double coarseness_of(const struct scene_mesh *mesh, const struct box *box,
                            const struct scene_extent *extent)
{
    double size = half_size(box->min, box->max);
    double step = fmax(farthest(box->min, box->max, extent->origin) * extent->steps * 0x1p-23,
                       EXTENT_STEP_MIN * extent->scale);
    double own_min[3], own_max[3];
    for (int k = 0; k < 3; k++) {
        own_min[k] = (double)mesh->bounds_min[k];
        own_max[k] = (double)mesh->bounds_max[k];
    }
    double own_size = half_size(own_min, own_max);
    double rounding = farthest(own_min, own_max, (const double[3]){0}) * 0x1p-22;
    return size > 0 && own_size > 0 ? fmax(step / size, rounding / own_size) : 0;
}

static void find_coarsest(const struct scene *scene, const struct scene_pose *pose,
                          struct scene_extent *extent)
{
    extent->coarseness = 0;
    for (uint32_t i = 0; i < scene->instance_count; i++) {
        const struct scene_mesh *mesh = &scene->meshes[scene->instances[i].mesh];
        if (scene->materials[mesh->material].kind == MATERIAL_DIFFUSE)
            continue;
        struct box box = box_of(mesh, pose->instance_to_world[i]);
        double coarseness = coarseness_of(mesh, &box, extent);
        if (coarseness > extent->coarseness) {
            extent->coarseness = coarseness;
            extent->coarsest = i;
        }
    }
}

bool scene_extent_find(const struct scene *scene, struct scene_extent *extent, struct error *error)
{
    *extent = (struct scene_extent){.scale = 1, .steps = EXTENT_STEPS};
    struct scene_pose *pose = scene_pose_create(scene, error);
    if (!pose)
        return false;
    struct box whole = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
    for (uint32_t i = 0; i < scene->instance_count; i++) {
        struct box box = box_of(&scene->meshes[scene->instances[i].mesh], pose->instance_to_world[i]);
        for (int k = 0; k < 3; k++) {
            whole.min[k] = fmin(whole.min[k], box.min[k]);
            whole.max[k] = fmax(whole.max[k], box.max[k]);
        }
    }
    double size = half_size(whole.min, whole.max);
    if (scene->instance_count > 0 && size > 0 && isfinite(size)) {
        int exponent;
        frexp(size, &exponent); /* 2^(exponent - 1) <= size < 2^exponent */
        extent->scale = ldexp(1, exponent < 1 ? exponent - 1 : exponent > 7 ? exponent - 7 : 0);
        double middle[3], grid = ldexp(1, exponent);
        for (int k = 0; k < 3; k++)
            middle[k] = 0.5 * (whole.min[k] + whole.max[k]);
        if (farthest(middle, middle, extent->origin) > 8 * size)
            for (int k = 0; k < 3; k++)
                extent->origin[k] = grid * nearbyint(middle[k] / grid);
    }
    find_coarsest(scene, pose, extent);
    if (extent->coarseness > EXTENT_COARSE) {
        extent->steps = EXTENT_STEPS_FINE;
        find_coarsest(scene, pose, extent);
    }
    scene_pose_destroy(&pose);
    return true;
}
