/* scene.h: a scene on the CPU, as imported from glTF or generated.
 *
 * Units: metres, right-handed, Y up; angles in radians; colours linear Rec. 709; a point or spot light's
 * intensity W/sr per channel (glTF candela taken as is), a directional light's W/m^2 (glTF lux); emission
 * W/(m^2 sr). Cameras and lights look down their node's -Z, as in glTF.
 *
 * All arrays are owned by the scene and freed by scene_destroy. A scene is immutable after it was made; what
 * moves is a scene_pose: the scene at one time.
 */
#ifndef CAUSTIC_SCENE_H
#define CAUSTIC_SCENE_H

#include <stddef.h>
#include <stdint.h>

#include "../status.h"

#define SCENE_NONE UINT32_MAX

/* Limits; the importer refuses what passes them and names the thing. */
#define SCENE_MAX_TRIANGLES  (64u << 20)
#define SCENE_MAX_VERTICES   (64u << 20)
#define SCENE_MAX_NODES      (1u << 20)
#define SCENE_MAX_INSTANCES  65536u
#define SCENE_MAX_LIGHTS     64u
#define SCENE_MAX_MATERIALS  65536u
#define SCENE_MAX_IMAGE_SIZE 8192u       /* pixels along a side */
#define SCENE_MAX_TEXELS     (64u << 20) /* of all images together */
#define SCENE_MAX_FILE_BYTES (2ull << 30)
#define SCENE_NAME_SIZE      64u

enum material_kind {
    MATERIAL_DIFFUSE,    /* receives light */
    MATERIAL_DIELECTRIC, /* solid: KHR_materials_transmission with KHR_materials_volume thickness > 0 */
    MATERIAL_THIN,       /* transmission without volume: straight through, tinted by base_color */
    MATERIAL_MIRROR      /* metallic >= 0.5 and roughness <= SCENE_MIRROR_ROUGHNESS */
};

#define SCENE_MIRROR_ROUGHNESS 0.25f
/* Up to here a rough surface's lobe is narrow enough for a footprint that grows linearly with it. */
#define SCENE_WIDEST_LOBE 0.4f

struct scene_material {
    char name[SCENE_NAME_SIZE];
    enum material_kind kind;
    float base_color[3];
    uint32_t base_color_image; /* SCENE_NONE: none; texel multiplies base_color */
    float metallic, roughness, transmission;
    float ior;                  /* >= 1; default 1.5 */
    float dispersion;           /* 20 / Abbe number (KHR_materials_dispersion); 0: none */
    float attenuation_color[3]; /* colour after attenuation_distance metres */
    float attenuation_distance; /* 0: no attenuation */
    float emission[3];          /* W/(m^2 sr), emissive_strength applied */
    uint32_t emission_image;    /* SCENE_NONE: none */
    bool double_sided;
};

struct scene_image {
    uint32_t width, height;
    uint16_t *texels; /* width*height RGBA half floats, linear Rec. 709, row 0 at v = 0 (the image's top) */
    bool clamp_u, clamp_v; /* else repeat; mirrored repeat counts as repeat */
};

struct scene_vertex {
    float position[3];
    float normal[3]; /* unit; generated (flat: vertices are then not shared) where the file has none */
    float uv[2];
};

/* A glTF primitive. */
struct scene_mesh {
    char name[SCENE_NAME_SIZE];
    uint32_t first_vertex, vertex_count;
    uint32_t first_index, triangle_count; /* indices are relative to first_vertex */
    uint32_t material;
    float bounds_min[3], bounds_max[3]; /* object space */
};

struct scene_node {
    char name[SCENE_NAME_SIZE];
    uint32_t parent; /* SCENE_NONE: root. A parent's index is always smaller than its child's. */
    float translation[3];
    float rotation[4]; /* quaternion x, y, z, w; unit */
    float scale[3];
    bool has_matrix;  /* then `matrix` instead of translation, rotation, scale */
    float matrix[16]; /* column-major */
};

struct scene_instance {
    uint32_t node, mesh;
};

enum light_type { LIGHT_POINT, LIGHT_SPOT, LIGHT_DIRECTIONAL };

/* What a light's rays start from. Its intensity is that of the whole: that of its point far away. */
enum light_shape {
    LIGHT_SHAPE_POINT,
    LIGHT_SHAPE_SPHERE,   /* of a point light; radiates evenly */
    LIGHT_SHAPE_DISK,     /* across the axis of a spot light; or an ellipse */
    LIGHT_SHAPE_RECTANGLE /* across the axis, its sides along the node's x and y */
};
#define SCENE_MAX_DISPERSION   10.0f /* an Abbe number of 2; diamond has 55, dense flint 20 */
#define SCENE_MAX_LIGHT_RADIUS 1e6   /* m */

struct scene_light {
    char
        name[SCENE_NAME_SIZE]; /* unique in the scene: the light's or node's name, numbered when it repeats */
    uint32_t node;
    enum light_type type;
    float intensity[3];           /* colour times intensity */
    float inner_cone, outer_cone; /* spot: half angles, 0 <= inner < outer <= pi/2 */
    enum light_shape shape;
    float half_size[2];    /* m along the node's x and y: radii or half sides; 0 for LIGHT_SHAPE_POINT */
    bool is_emissive_mesh; /* stands in for an open emissive mesh: a cosine emitter (intensity
                              I cos(theta) about the direction) at its centroid, see scene.warnings */
};

struct scene_camera {
    char name[SCENE_NAME_SIZE]; /* unique in the scene */
    uint32_t node;
    float yfov;   /* vertical, radians */
    float aspect; /* width/height; 0: free */
};

enum animation_path { ANIMATION_TRANSLATION, ANIMATION_ROTATION, ANIMATION_SCALE };
enum animation_interpolation { ANIMATION_STEP, ANIMATION_LINEAR, ANIMATION_CUBIC };

struct scene_channel {
    uint32_t node;
    enum animation_path path;
    enum animation_interpolation interpolation;
    uint32_t key_count;
    float *times;  /* key_count, rising, seconds */
    float *values; /* key_count (x3 for cubic: in-tangent, value, out-tangent) x 3 or 4 floats */
};

struct scene {
    char name[SCENE_NAME_SIZE];
    struct scene_vertex *vertices;
    uint32_t *indices;
    struct scene_mesh *meshes;
    struct scene_material *materials;
    struct scene_image *images;
    struct scene_node *nodes;
    struct scene_instance *instances;
    struct scene_light *lights;
    struct scene_camera *cameras;
    struct scene_channel *channels; /* of all animations; they play together and loop at `duration` */
    char **warnings;                /* what was imported differently than the file asks */
    uint32_t vertex_count, index_count, mesh_count, material_count, image_count, node_count, instance_count,
        light_count, camera_count, channel_count, warning_count;
    uint32_t triangle_count; /* over instances */
    float duration;          /* seconds of the longest animation; 0: still */
};

void scene_destroy(struct scene **scene);

/* ---- sources ------------------------------------------------------------------------------------------ */

/* A built-in scene's name, or a path ending in .gltf or .glb. */
struct scene *scene_open(const char *name_or_path, struct error *error);

/* glTF 2.0: JSON with buffers and images beside it, or GLB. Nothing outside the file's folder is opened. */
struct scene *scene_import(const char *path, struct error *error);

/* The same from memory, for tests and fuzzing: no external files at all. */
struct scene *scene_import_memory(const void *bytes, size_t size, struct error *error);

/* As GLB. Importing that gives the same scene bit for bit, but for textures, which are left out. */
bool scene_export(const struct scene *scene, const char *path, struct error *error);

struct builtin_scene {
    const char *name, *summary;
};
extern const struct builtin_scene builtin_scenes[];
extern const uint32_t builtin_scene_count;
struct scene *scene_create_builtin(const char *name, struct error *error);

/* ---- the scene at one time ---------------------------------------------------------------------------- */

struct pose_light {
    float position[3];
    float direction[3]; /* unit, the way light travels along the axis of a spot or directional light */
    float side[3];      /* unit, across the direction: the node's x axis */
};

struct pose_camera {
    float eye[3], forward[3], up[3]; /* unit, orthogonal */
};

struct scene_pose {
    float (*instance_to_world)[12]; /* per instance, row-major 3x4 */
    struct pose_light *lights;
    struct pose_camera *cameras;
};

struct scene_pose *scene_pose_create(const struct scene *scene, struct error *error);
void scene_pose_destroy(struct scene_pose **pose);

/* From the next scene_pose_set_time on, positions of instances, lights and cameras are relative to this
 * point; (0, 0, 0) at first. The difference is taken in double. */
void scene_pose_set_origin(struct scene_pose *pose, const double origin[3]);

/* Evaluates at `time` seconds (any finite value; loops over scene.duration; negative counts back from the
 * end). Returns true when anything differs from what the pose held before. */
bool scene_pose_set_time(const struct scene *scene, struct scene_pose *pose, double time);

#endif
