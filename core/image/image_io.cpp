#include "image_io.h"

#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

#ifdef CAUSTIC_HAS_IMAGES

#include <cerrno>
#include <memory>
#include <mutex>
#include <vector>

#include <OpenImageIO/imageio.h>
#include <sys/mman.h>
#include <unistd.h>

/* OpenImageIO reads from a name. A memory file has one (/proc/self/fd/N) without touching a disk, for every
 * format of every version; its I/O proxies came to PNG, JPEG and HDR one by one. */
class memory_file {
  public:
    memory_file(const void *bytes, size_t size)
    {
        file_ = memfd_create("image", MFD_CLOEXEC);
        size_t have = 0;
        while (file_ >= 0 && have < size) {
            ssize_t wrote = write(file_, (const char *)bytes + have, size - have);
            if (wrote <= 0) {
                close(file_);
                file_ = -1;
            }
            have += wrote > 0 ? (size_t)wrote : 0;
        }
    }
    ~memory_file()
    {
        if (file_ >= 0)
            close(file_);
    }
    memory_file(const memory_file &) = delete;
    memory_file &operator=(const memory_file &) = delete;
    bool is_open() const
    {
        return file_ >= 0;
    }
    std::string path() const
    {
        return "/proc/self/fd/" + std::to_string(file_);
    }

  private:
    int file_;
};

/* Its thread pools gain nothing at our sizes, and a server counts its threads. */
static void configure_once()
{
    static std::once_flag once;
    std::call_once(once, [] {
        OIIO::attribute("threads", 1);
        OIIO::attribute("exr_threads", -1);
    });
}

/* Runs what may throw; whatever comes out becomes an error. */
template <typename Work> static bool guarded(const char *name, struct error *error, Work work)
{
    try {
        configure_once();
        return work();
    } catch (const std::bad_alloc &) {
        return error_set(error, STATUS_MEMORY, "%s: out of memory", name);
    } catch (const std::exception &problem) {
        return error_set(error, STATUS_INVALID, "%s: %s", name, problem.what());
    } catch (...) {
        return error_set(error, STATUS_INVALID, "%s: unknown failure of OpenImageIO", name);
    }
}

/* Its messages end with newlines and may run over several lines. */
static std::string one_line(std::string text)
{
    while (!text.empty() && (text.back() == '\n' || text.back() == '.'))
        text.pop_back();
    for (char &c : text)
        if ((unsigned char)c < 0x20)
            c = ' ';
    return text.empty() ? "no reason given" : text;
}

/* By the file's first bytes; NULL: none of ours. */
static const char *format_of(const unsigned char *bytes, size_t size)
{
    static const struct {
        const char *format, *magic;
        size_t length;
    } formats[] = {
        {"png", "\x89PNG\r\n\x1a\n", 8}, {"jpeg", "\xff\xd8\xff", 3}, {"openexr", "\x76\x2f\x31\x01", 4},
        {"hdr", "#?RADIANCE", 10},       {"hdr", "#?RGBE", 6},
    };
    for (const auto &known : formats)
        if (size >= known.length && !memcmp(bytes, known.magic, known.length))
            return known.format;
    return nullptr;
}

/* Whether a PNG's chunks lie within its bytes, to the last one. OpenImageIO's reader loses memory when libpng
 * runs into the end of a file: its read callback's strings are jumped over. */
static bool is_whole_png(const unsigned char *bytes, size_t size)
{
    for (size_t at = 8; size - at >= 12;) {
        size_t length = (size_t)bytes[at] << 24 | (size_t)bytes[at + 1] << 16 | (size_t)bytes[at + 2] << 8 |
                        bytes[at + 3];
        if (length > size - at - 12)
            return false;
        if (!memcmp(bytes + at + 4, "IEND", 4))
            return true;
        at += 12 + length;
    }
    return false;
}

static float decode_srgb(float value)
{
    return value <= 0.04045f ? value / 12.92f : std::pow((value + 0.055f) / 1.055f, 2.4f);
}

static bool decode(const void *bytes, size_t size, const struct image_decode_params *params,
                   struct image_texels *texels, const char *name, struct error *error)
{
    const char *format = format_of((const unsigned char *)bytes, size);
    if (!format)
        return error_set(error, STATUS_INVALID, "%s is no PNG, JPEG, EXR or HDR", name);
    if (!strcmp(format, "png") && !is_whole_png((const unsigned char *)bytes, size))
        return error_set(error, STATUS_INVALID, "%s: the PNG is truncated", name);
    memory_file file(bytes, size);
    if (!file.is_open())
        return error_set(error, STATUS_IO, "%s: cannot hold %zu bytes in a memory file: %s", name, size,
                         strerror(errno));
    std::unique_ptr<OIIO::ImageInput> input = OIIO::ImageInput::create(format);
    if (!input)
        return error_set(error, STATUS_UNSUPPORTED, "%s: this OpenImageIO cannot read %s", name, format);
    OIIO::ImageSpec wanted, spec;
    wanted.attribute("oiio:UnassociatedAlpha", 1); /* a base colour is not multiplied by its alpha */
    if (!input->open(file.path(), spec, wanted))
        return error_set(error, STATUS_INVALID, "%s: %s", name, one_line(input->geterror()).c_str());
    uint32_t max_size = params->max_size ? params->max_size : 8192;
    uint64_t max_texels = params->max_texels ? params->max_texels : (uint64_t)max_size * max_size;
    if (spec.width < 1 || spec.height < 1 || spec.depth > 1 || spec.nchannels < 1 || spec.deep)
        return error_set(error, STATUS_INVALID, "%s: %d x %d pixels of %d channels%s", name, spec.width,
                         spec.height, spec.nchannels, spec.deep ? ", deep" : "");
    uint32_t width = (uint32_t)spec.width, height = (uint32_t)spec.height;
    if (width > max_size || height > max_size || (uint64_t)width * height > max_texels)
        return error_set(error, STATUS_LIMIT,
                         "%s has %u x %u pixels; a side may have %u, and %llu in all are left", name, width,
                         height, max_size, (unsigned long long)max_texels);
    size_t channels = spec.nchannels < 4 ? (size_t)spec.nchannels : 4, count = (size_t)width * height;
    std::vector<float> values(count * channels);
    if (!input->read_image(0, 0, 0, (int)channels, OIIO::TypeDesc::FLOAT, values.data()))
        return error_set(error, STATUS_INVALID, "%s: %s", name, one_line(input->geterror()).c_str());

    bool is_encoded = params->is_srgb && !spec.format.is_floating_point();
    size_t colors = channels < 3 ? 1 : 3;
    uint16_t *out = (uint16_t *)malloc(count * 4 * sizeof *out);
    if (!out)
        throw std::bad_alloc();
    uint64_t nonfinite = 0;
    for (size_t i = 0; i < count; i++) {
        const float *from = &values[i * channels];
        for (size_t channel = 0; channel < 4; channel++) {
            float value =
                channel == 3 ? (channels > colors ? from[colors] : 1) : from[colors == 1 ? 0 : channel];
            if (is_encoded && channel < 3)
                value = decode_srgb(value);
            uint16_t half = image_half_from_float(value);
            nonfinite += (half & 0x7c00) == 0x7c00;
            out[i * 4 + channel] = half;
        }
    }
    *texels = {width, height, out, nonfinite};
    return true;
}

bool image_decode(const void *bytes, size_t size, const struct image_decode_params *params,
                  struct image_texels *texels, struct error *error)
{
    const char *name = params->name ? params->name : "image";
    *texels = {};
    return guarded(name, error, [&] { return decode(bytes, size, params, texels, name, error); });
}

/* ---- writing ------------------------------------------------------------------------------------------ */

/* Writes to a name of its own, then renames: a reader never sees half a file. */
template <typename Fill>
static bool write_whole(const char *path, const char *format, OIIO::ImageSpec &spec, struct error *error,
                        Fill fill)
{
    return guarded(path, error, [&] {
        std::string temporary = std::string(path) + ".part" + std::to_string(getpid());
        std::unique_ptr<OIIO::ImageOutput> output = OIIO::ImageOutput::create(format);
        if (!output)
            return error_set(error, STATUS_UNSUPPORTED, "%s: this OpenImageIO cannot write %s", path, format);
        bool is_written = output->open(temporary, spec) && fill(*output);
        std::string reason = is_written ? "" : one_line(output->geterror());
        if (!output->close() && is_written) {
            is_written = false;
            reason = one_line(output->geterror());
        }
        if (is_written && rename(temporary.c_str(), path) != 0) {
            is_written = false;
            reason = strerror(errno);
        }
        if (is_written)
            return true;
        unlink(temporary.c_str());
        return error_set(error, STATUS_IO, "cannot write %s: %s", path, reason.c_str());
    });
}

static void set_attribute(OIIO::ImageSpec &spec, const struct image_attribute &attribute)
{
    switch (attribute.type) {
    case IMAGE_ATTRIBUTE_STRING:
        spec.attribute(attribute.name, attribute.string ? attribute.string : "");
        break;
    case IMAGE_ATTRIBUTE_FLOAT:
        spec.attribute(attribute.name, (float)attribute.number);
        break;
    case IMAGE_ATTRIBUTE_INT:
        spec.attribute(attribute.name, (int)attribute.number);
        break;
    case IMAGE_ATTRIBUTE_MATRIX:
        spec.attribute(attribute.name, OIIO::TypeMatrix, attribute.matrix);
        break;
    }
}

bool image_write_exr(const char *path, const struct image_write_params *params, struct error *error)
{
    if (!params->width || !params->height || !params->plane_count || params->width > 65536 ||
        params->height > 65536 || params->plane_count > 256)
        return error_set(error, STATUS_INVALID, "cannot write %s: %u x %u pixels of %u channels", path,
                         params->width, params->height, params->plane_count);
    size_t count = (size_t)params->width * params->height, planes = params->plane_count;
    OIIO::ImageSpec spec((int)params->width, (int)params->height, (int)planes, OIIO::TypeDesc::FLOAT);
    spec.attribute("compression", "zip");
    spec.channelnames.clear();
    for (size_t i = 0; i < planes; i++)
        spec.channelnames.push_back(params->planes[i].name);
    spec.alpha_channel = -1;
    spec.z_channel = -1;
    for (uint32_t i = 0; i < params->attribute_count; i++)
        set_attribute(spec, params->attributes[i]);
    return write_whole(path, "openexr", spec, error, [&](OIIO::ImageOutput &output) {
        std::vector<float> pixels(count * planes);
        for (size_t plane = 0; plane < planes; plane++)
            for (size_t i = 0; i < count; i++)
                pixels[i * planes + plane] = params->planes[plane].values[i];
        return output.write_image(OIIO::TypeDesc::FLOAT, pixels.data());
    });
}

bool image_write_png(const char *path, uint32_t width, uint32_t height, uint32_t components,
                     const uint8_t *pixels, struct error *error)
{
    if (!width || !height || width > 65536 || height > 65536 ||
        (components != 1 && components != 3 && components != 4))
        return error_set(error, STATUS_INVALID, "cannot write %s: %u x %u pixels of %u components", path,
                         width, height, components);
    OIIO::ImageSpec spec((int)width, (int)height, (int)components, OIIO::TypeDesc::UINT8);
    spec.attribute("oiio:UnassociatedAlpha", 1);
    spec.attribute("oiio:ColorSpace", "sRGB");
    return write_whole(path, "png", spec, error, [&](OIIO::ImageOutput &output) {
        return output.write_image(OIIO::TypeDesc::UINT8, pixels);
    });
}

/* ---- reading planes ----------------------------------------------------------------------------------- */

/* Whole, into memory, for the one check that needs it. */
static bool is_whole_png_file(const char *path)
{
    std::vector<unsigned char> bytes;
    FILE *file = fopen(path, "rb");
    if (!file)
        return false;
    unsigned char block[65536];
    for (size_t got; (got = fread(block, 1, sizeof block, file)) > 0;)
        bytes.insert(bytes.end(), block, block + got);
    fclose(file);
    return is_whole_png(bytes.data(), bytes.size());
}

/* `only`: the one format that is taken; NULL: any of ours. */
static std::unique_ptr<OIIO::ImageInput> open_file(const char *path, const char *only, OIIO::ImageSpec &spec,
                                                   struct error *error)
{
    unsigned char magic[16] = {0};
    FILE *file = fopen(path, "rb");
    if (!file) {
        error_set(error, errno == ENOENT ? STATUS_NOT_FOUND : STATUS_IO, "cannot open %s: %s", path,
                  strerror(errno));
        return nullptr;
    }
    size_t got = fread(magic, 1, sizeof magic, file);
    bool is_unreadable = ferror(file);
    fclose(file);
    if (is_unreadable || !got) {
        error_set(error, is_unreadable ? STATUS_IO : STATUS_INVALID, "%s %s", path,
                  is_unreadable ? "cannot be read" : "is empty");
        return nullptr;
    }
    const char *format = format_of(magic, got);
    if (!format || (only && strcmp(format, only) != 0)) {
        error_set(error, STATUS_INVALID, only ? "%s is no EXR file" : "%s is no EXR, PFM, HDR, PNG or JPEG",
                  path);
        return nullptr;
    }
    if (!strcmp(format, "png") && !is_whole_png_file(path)) {
        error_set(error, STATUS_INVALID, "%s: the PNG is truncated", path);
        return nullptr;
    }
    std::unique_ptr<OIIO::ImageInput> input = OIIO::ImageInput::create(format);
    if (!input) {
        error_set(error, STATUS_UNSUPPORTED, "%s: this OpenImageIO cannot read %s", path, format);
        return nullptr;
    }
    OIIO::ImageSpec wanted;
    wanted.attribute("oiio:UnassociatedAlpha", 1);
    if (!input->open(path, spec, wanted)) {
        error_set(error, STATUS_INVALID, "%s: %s", path, one_line(input->geterror()).c_str());
        return nullptr;
    }
    if (spec.width < 1 || spec.height < 1 || spec.depth > 1 || spec.deep || spec.nchannels < 1) {
        error_set(error, STATUS_INVALID, "%s: %d x %d pixels of %d channels%s", path, spec.width, spec.height,
                  spec.nchannels, spec.deep ? ", deep" : "");
        return nullptr;
    }
    if (spec.width > IMAGE_MAX_SIDE || spec.height > IMAGE_MAX_SIDE || spec.nchannels > 256 ||
        (uint64_t)spec.width * (uint64_t)spec.height * (uint64_t)spec.nchannels > IMAGE_MAX_VALUES) {
        error_set(error, STATUS_LIMIT,
                  "%s has %d x %d pixels of %d channels; the most is %d x %d of 256, and %llu values in all",
                  path, spec.width, spec.height, spec.nchannels, IMAGE_MAX_SIDE, IMAGE_MAX_SIDE,
                  (unsigned long long)IMAGE_MAX_VALUES);
        return nullptr;
    }
    return input;
}

static struct image_file *read_file(const char *path, const char *only, struct error *error)
{
    struct image_file *file = NULL;
    bool is_read = guarded(path, error, [&] {
        OIIO::ImageSpec spec;
        std::unique_ptr<OIIO::ImageInput> input = open_file(path, only, spec, error);
        if (!input)
            return false;
        size_t planes = (size_t)spec.nchannels, count = (size_t)spec.width * (size_t)spec.height;
        std::vector<float> pixels(count * planes);
        if (!input->read_image(0, 0, 0, (int)planes, OIIO::TypeDesc::FLOAT, pixels.data()))
            return error_set(error, STATUS_INVALID, "%s: %s", path, one_line(input->geterror()).c_str());
        file = (struct image_file *)calloc(1, sizeof *file);
        if (file) {
            file->planes = (struct image_plane *)calloc(planes, sizeof *file->planes);
            file->values = (float *)malloc(count * planes * sizeof *file->values);
        }
        if (!file || !file->planes || !file->values)
            throw std::bad_alloc();
        file->width = (uint32_t)spec.width;
        file->height = (uint32_t)spec.height;
        file->plane_count = (uint32_t)planes;
        file->is_integer = !spec.format.is_floating_point();
        for (size_t plane = 0; plane < planes; plane++) {
            snprintf(file->planes[plane].name, IMAGE_CHANNEL_NAME_SIZE, "%s",
                     spec.channelnames.at(plane).c_str());
            float *values = file->values + plane * count;
            for (size_t i = 0; i < count; i++)
                values[i] = pixels[i * planes + plane];
            file->planes[plane].values = values;
        }
        return true;
    });
    if (!is_read)
        image_file_destroy(&file);
    return file;
}

struct image_file *image_read_exr(const char *path, struct error *error)
{
    return read_file(path, "openexr", error);
}

struct image_file *image_read_planes(const char *path, struct error *error)
{
    return read_file(path, NULL, error);
}

bool image_read_exr_string(const char *path, const char *name, char *text, size_t size, struct error *error)
{
    return guarded(path, error, [&] {
        OIIO::ImageSpec spec;
        if (!open_file(path, "openexr", spec, error))
            return false;
        const OIIO::ParamValue *value = spec.find_attribute(name, OIIO::TypeDesc::STRING);
        if (!value)
            return error_set(error, STATUS_NOT_FOUND, "%s has no text attribute \"%s\"", path, name);
        snprintf(text, size, "%s", value->get_string().c_str());
        return true;
    });
}

bool image_read_exr_matrix(const char *path, const char *name, float matrix[16], struct error *error)
{
    return guarded(path, error, [&] {
        OIIO::ImageSpec spec;
        if (!open_file(path, "openexr", spec, error))
            return false;
        const OIIO::ParamValue *value = spec.find_attribute(name, OIIO::TypeMatrix);
        if (!value)
            return error_set(error, STATUS_NOT_FOUND, "%s has no matrix attribute \"%s\"", path, name);
        memcpy(matrix, value->data(), 16 * sizeof(float));
        return true;
    });
}

#else /* without OpenImageIO */

static bool unsupported(const char *name, struct error *error)
{
    return error_set(error, STATUS_UNSUPPORTED, "%s: this build has no image files (CAUSTICD_IMAGES is off)",
                     name);
}

bool image_decode(const void *, size_t, const struct image_decode_params *params, struct image_texels *texels,
                  struct error *error)
{
    *texels = {};
    return unsupported(params->name ? params->name : "image", error);
}

bool image_write_exr(const char *path, const struct image_write_params *, struct error *error)
{
    return unsupported(path, error);
}

bool image_write_png(const char *path, uint32_t, uint32_t, uint32_t, const uint8_t *, struct error *error)
{
    return unsupported(path, error);
}

struct image_file *image_read_exr(const char *path, struct error *error)
{
    unsupported(path, error);
    return NULL;
}

struct image_file *image_read_planes(const char *path, struct error *error)
{
    unsupported(path, error);
    return NULL;
}

bool image_read_exr_string(const char *path, const char *, char *, size_t, struct error *error)
{
    return unsupported(path, error);
}

bool image_read_exr_matrix(const char *path, const char *, float[16], struct error *error)
{
    return unsupported(path, error);
}

#endif

/* ---- either way --------------------------------------------------------------------------------------- */

const float *image_file_plane(const struct image_file *file, const char *name)
{
    for (uint32_t i = 0; i < file->plane_count; i++)
        if (!strcmp(file->planes[i].name, name))
            return file->planes[i].values;
    return NULL;
}

void image_file_destroy(struct image_file **file)
{
    if (!*file)
        return;
    free((*file)->planes);
    free((*file)->values);
    free(*file);
    *file = NULL;
}
