#include "pictures.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../../core/image/image_io.h"
#include "../lib/tone.h"

#define MAX_PLANES 64u
#define MAX_NOTES  (PROTOCOL_MAX_SETTINGS + 24u)
#define PATH_SIZE  4096u

/* ---- EXR ---------------------------------------------------------------------------------------------- */

/* Channel `c` of `components` as EXR names it. */
static void plane_name(const char *channel, uint32_t component, uint32_t components, char *name, size_t size)
{
    static const char rgba[] = "RGBA", xyz[] = "XYZW";
    if (strcmp(channel, "beauty") == 0)
        snprintf(name, size, "%c", rgba[component]);
    else if (strcmp(channel, "depth") == 0)
        snprintf(name, size, "Z");
    else if (strcmp(channel, "normal") == 0)
        snprintf(name, size, "N.%c", xyz[component]);
    else if (components == 1)
        snprintf(name, size, "%s", channel);
    else
        snprintf(name, size, "%s.%c", channel, rgba[component]);
}

static struct image_attribute text_attribute(const char *name, const char *text)
{
    return (struct image_attribute){.name = name, .type = IMAGE_ATTRIBUTE_STRING, .string = text};
}

static struct image_attribute number_attribute(const char *name, double number)
{
    return (struct image_attribute){.name = name, .type = IMAGE_ATTRIBUTE_FLOAT, .number = number};
}

struct exr_file {
    char path[PATH_SIZE];
    uint32_t width, height, plane_count;
    struct image_plane planes[MAX_PLANES];
    float *values[MAX_PLANES];
};

static bool add_channel(struct exr_file *file, const char *name, const struct protocol_channel *channel,
                        const float *values, struct error *error)
{
    size_t pixels = (size_t)channel->width * channel->height;
    file->width = channel->width;
    file->height = channel->height;
    for (uint32_t c = 0; c < channel->components; c++) {
        uint32_t index = file->plane_count;
        float *plane = malloc(pixels * sizeof *plane);
        if (!plane)
            return error_set(error, STATUS_MEMORY, "%s: no memory for %ux%u pixels", file->path,
                             channel->width, channel->height);
        for (size_t i = 0; i < pixels; i++)
            plane[i] = values[i * channel->components + c];
        plane_name(name, c, channel->components, file->planes[index].name, sizeof file->planes[index].name);
        file->planes[index].values = file->values[index] = plane;
        file->plane_count++;
    }
    return true;
}

static bool write_exr(const struct pictures *pictures, const struct client_frame *frame,
                      struct exr_file *file, struct error *error)
{
    const struct protocol_frame *info = &frame->info;
    char version[128], scene[128], device[300], number[32], names[MAX_NOTES][80];
    struct image_attribute attributes[MAX_NOTES];
    uint32_t count = 0;
    protocol_text_copy(pictures->hello->version, version, sizeof version);
    protocol_text_copy(pictures->hello->scene, scene, sizeof scene);
    protocol_text_copy(pictures->hello->device, device, sizeof device);
    snprintf(number, sizeof number, "%llu", (unsigned long long)info->frame);
    attributes[count++] = text_attribute("Software", version);
    /* OpenImageIO would write the time of day; the same recording is to give the same bytes. */
    attributes[count++] = text_attribute("DateTime", "1970:01:01 00:00:00");
    attributes[count++] = text_attribute("caustic.version", version);
    attributes[count++] = text_attribute("caustic.scene", scene);
    attributes[count++] = text_attribute("caustic.device", device);
    attributes[count++] = text_attribute("caustic.frame", number);
    attributes[count++] = number_attribute("caustic.time", info->time);
    attributes[count++] = (struct image_attribute){
        .name = "caustic.seed", .type = IMAGE_ATTRIBUTE_INT, .number = pictures->seed};
    attributes[count++] = (struct image_attribute){
        .name = "worldToCamera", .type = IMAGE_ATTRIBUTE_MATRIX, .matrix = info->world_to_camera};
    attributes[count++] = (struct image_attribute){
        .name = "cameraToClip", .type = IMAGE_ATTRIBUTE_MATRIX, .matrix = info->camera_to_clip};
    char eye[96], at[96], up[96];
    snprintf(eye, sizeof eye, "%.9g,%.9g,%.9g", (double)info->camera.eye[0], (double)info->camera.eye[1],
             (double)info->camera.eye[2]);
    snprintf(at, sizeof at, "%.9g,%.9g,%.9g", (double)info->camera.at[0], (double)info->camera.at[1],
             (double)info->camera.at[2]);
    snprintf(up, sizeof up, "%.9g,%.9g,%.9g", (double)info->camera.up[0], (double)info->camera.up[1],
             (double)info->camera.up[2]);
    attributes[count++] = text_attribute("caustic.camera.eye", eye);
    attributes[count++] = text_attribute("caustic.camera.at", at);
    attributes[count++] = text_attribute("caustic.camera.up", up);
    attributes[count++] = number_attribute("caustic.camera.fov", (double)info->camera.fov);
    for (uint32_t i = 0; i < pictures->note_count && count < MAX_NOTES; i++, count++) {
        snprintf(names[count], sizeof names[count], "caustic.%s", pictures->notes[i].name);
        attributes[count] = text_attribute(names[count], pictures->notes[i].text);
    }
    return image_write_exr(file->path,
                           &(struct image_write_params){.width = file->width,
                                                        .height = file->height,
                                                        .planes = file->planes,
                                                        .plane_count = file->plane_count,
                                                        .attributes = attributes,
                                                        .attribute_count = count},
                           error);
}

static void free_planes(struct exr_file *file)
{
    for (uint32_t i = 0; i < file->plane_count; i++)
        free(file->values[i]);
    file->plane_count = 0;
}

/* Whether a channel has one value per pixel; the task buffers are atlases of their own size. */
static bool is_pixel_channel(const char *name)
{
    return strcmp(name, "density") != 0 && strcmp(name, "variance") != 0;
}

static void channel_name(const struct pictures *pictures, const struct protocol_channel *channel, char *name,
                         size_t size)
{
    *name = 0;
    if (channel->channel < pictures->hello->channel_count)
        protocol_text_copy(pictures->hello->channels[channel->channel].name, name, size);
}

static bool write_exr_files(struct pictures *pictures, const struct client_frame *frame, uint32_t number,
                            struct error *error)
{
    bool is_written = true;
    struct exr_file *pixels = calloc(2, sizeof *pixels);
    if (!pixels)
        return error_set(error, STATUS_MEMORY, "no memory for a picture");
    struct exr_file *own = pixels + 1;
    snprintf(pictures->file, sizeof pictures->file, "frame_%04u.exr", number);
    snprintf(pixels->path, sizeof pixels->path, "%s/%s", pictures->folder, pictures->file);
    for (uint32_t i = 0; i < frame->info.channel_count && is_written; i++) {
        const struct protocol_channel *channel = &frame->info.channels[i];
        char name[48];
        channel_name(pictures, channel, name, sizeof name);
        if (is_pixel_channel(name)) {
            is_written = add_channel(pixels, name, channel, frame->values[i], error);
            continue;
        }
        snprintf(own->path, sizeof own->path, "%s/%s_%04u.exr", pictures->folder, name, number);
        is_written = add_channel(own, name, channel, frame->values[i], error) &&
                     write_exr(pictures, frame, own, error);
        free_planes(own);
    }
    if (pixels->plane_count == 0)
        pictures->file[0] = 0;
    else if (is_written)
        is_written = write_exr(pictures, frame, pixels, error);
    free_planes(pixels);
    free(pixels);
    return is_written;
}

/* ---- PNG ---------------------------------------------------------------------------------------------- */

static bool write_png(struct pictures *pictures, const struct client_frame *frame, uint32_t number,
                      struct error *error)
{
    static const char *const wanted[] = {"beauty", "caustics", "irradiance"};
    uint32_t index = frame->info.channel_count;
    for (size_t w = 0; w < sizeof wanted / sizeof *wanted && index == frame->info.channel_count; w++) {
        for (index = 0; index < frame->info.channel_count; index++) {
            char name[48];
            channel_name(pictures, &frame->info.channels[index], name, sizeof name);
            if (strcmp(name, wanted[w]) == 0 && frame->info.channels[index].components == 3)
                break;
        }
    }
    if (index == frame->info.channel_count)
        return error_set(error, STATUS_INVALID,
                         "--png needs beauty, caustics or irradiance among --channels");
    const struct protocol_channel *channel = &frame->info.channels[index];
    const float *values = frame->values[index];
    size_t pixel_count = (size_t)channel->width * channel->height;
    double exposure = pictures->has_exposure ? pictures->exposure : tone_exposure(values, pixel_count);
    if (exposure != 0 && !pictures->has_exposure) {
        pictures->has_exposure = true;
        pictures->exposure = exposure;
    }
    uint8_t *pixels = malloc(pixel_count * 3);
    if (!pixels)
        return error_set(error, STATUS_MEMORY, "no memory for a picture of %ux%u pixels", channel->width,
                         channel->height);
    for (size_t i = 0; i < pixel_count * 3; i++)
        pixels[i] = tone_byte(values[i], exposure);
    char path[PATH_SIZE];
    snprintf(path, sizeof path, "%s/frame_%04u.png", pictures->folder, number);
    bool is_written = image_write_png(path, channel->width, channel->height, 3, pixels, error);
    free(pixels);
    return is_written;
}

bool pictures_write(struct pictures *pictures, const struct client_frame *frame, uint32_t number,
                    struct error *error)
{
    return write_exr_files(pictures, frame, number, error) &&
           (!pictures->png || write_png(pictures, frame, number, error));
}
