#include "gltf_document.hpp"

#include <cerrno>
#include <climits>
#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

using nlohmann::json;

/* JSON of a scene is small next to its buffers, except where those are embedded as text. */
static constexpr size_t max_json_bytes = size_t(512) << 20;
/* Deeper nesting than any glTF needs; bounds the parser's recursion over "extras". */
static constexpr int max_json_depth = 64;
/* Values, counted by their separators: each costs some 16 to 100 bytes of memory when parsed. */
static constexpr size_t max_json_values = size_t(8) << 20;
static constexpr size_t max_list = 1u << 20;

void gltf_fail(enum status status, const char *format, ...)
{
    char text[480];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    throw gltf_error{status, text};
}

std::string gltf_quoted(const std::string &name)
{
    std::string out = "\"";
    for (size_t i = 0; i < name.size() && i < 60; i++)
        out += (unsigned char)name[i] < 0x20 || name[i] == 0x7f ? '?' : name[i];
    return out + (name.size() > 60 ? "...\"" : "\"");
}

/* ---- files -------------------------------------------------------------------------------------------- */

/* Opened so that neither a pipe nor a device can make us wait. */
static std::vector<unsigned char> read_regular(const std::string &path, const std::string &shown, int flags,
                                               uint64_t limit)
{
    int file = open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK | flags);
    if (file < 0)
        gltf_fail(errno == ENOENT ? STATUS_NOT_FOUND : STATUS_IO, "cannot open %s: %s",
                  gltf_quoted(shown).c_str(), strerror(errno));
    struct stat info;
    if (fstat(file, &info) != 0 || !S_ISREG(info.st_mode)) {
        close(file);
        gltf_fail(STATUS_INVALID, "%s is not a regular file", gltf_quoted(shown).c_str());
    }
    uint64_t size = (uint64_t)info.st_size;
    if (size > limit) {
        close(file);
        gltf_fail(STATUS_LIMIT, "%s has %llu bytes; all files of a scene together may have %llu",
                  gltf_quoted(shown).c_str(), (unsigned long long)size,
                  (unsigned long long)SCENE_MAX_FILE_BYTES);
    }
    std::vector<unsigned char> bytes;
    try {
        bytes.resize(size);
    } catch (...) {
        close(file);
        throw;
    }
    size_t have = 0;
    while (have < bytes.size()) {
        ssize_t got = ::read(file, bytes.data() + have, bytes.size() - have);
        if (got <= 0) {
            int reason = errno;
            close(file);
            gltf_fail(STATUS_IO, "cannot read %s: %s", gltf_quoted(shown).c_str(),
                      got < 0 ? strerror(reason) : "it became shorter while it was read");
        }
        have += (size_t)got;
    }
    close(file);
    return bytes;
}

std::vector<unsigned char> gltf_read_file(const std::string &path)
{
    return read_regular(path, path, 0, SCENE_MAX_FILE_BYTES);
}

static std::string decode_percent(const std::string &uri)
{
    std::string out;
    for (size_t i = 0; i < uri.size(); i++) {
        if (uri[i] == '%' && i + 2 < uri.size() && isxdigit((unsigned char)uri[i + 1]) &&
            isxdigit((unsigned char)uri[i + 2])) {
            out += (char)strtol(uri.substr(i + 1, 2).c_str(), nullptr, 16);
            i += 2;
        } else {
            out += uri[i];
        }
    }
    return out;
}

std::vector<unsigned char> gltf_folder::read(const std::string &uri)
{
    std::string shown = gltf_quoted(uri), path = decode_percent(uri);
    if (real_path_.empty())
        gltf_fail(STATUS_INVALID, "the file %s cannot be read: this scene has no folder", shown.c_str());
    if (path.empty() || path.find('\0') != std::string::npos)
        gltf_fail(STATUS_INVALID, "the file name %s is malformed", shown.c_str());
    if (path[0] == '/' || path[0] == '\\' || path.find(':') != std::string::npos)
        gltf_fail(STATUS_INVALID,
                  "%s is refused: only files in the scene's own folder are read, no absolute paths and "
                  "no URLs",
                  shown.c_str());
    std::string joined = real_path_ + "/" + path;
    char *resolved = realpath(joined.c_str(), nullptr);
    if (!resolved)
        gltf_fail(errno == ENOENT ? STATUS_NOT_FOUND : STATUS_IO, "cannot open %s beside the scene: %s",
                  shown.c_str(), strerror(errno));
    std::string real = resolved;
    free(resolved);
    if (real.compare(0, real_path_.size() + 1, real_path_ + "/") != 0)
        gltf_fail(STATUS_INVALID, "%s is refused: it leaves the scene's folder", shown.c_str());
    /* After realpath no part is a link; should the last one become one in between, it is not followed. */
    std::vector<unsigned char> bytes =
        read_regular(real, uri, O_NOFOLLOW, SCENE_MAX_FILE_BYTES - bytes_read_);
    bytes_read_ += bytes.size();
    return bytes;
}

/* ---- before parsing ----------------------------------------------------------------------------------- */

struct glb_chunks {
    const char *json;
    size_t json_size;
    size_t binary_size; /* 0: none */
};

static uint32_t read_u32(const unsigned char *bytes)
{
    return (uint32_t)bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 | (uint32_t)bytes[3] << 24;
}

static glb_chunks check_glb(const unsigned char *bytes, size_t size)
{
    if (size < 20)
        gltf_fail(STATUS_INVALID, "the GLB is truncated: %zu bytes are fewer than its headers", size);
    if (read_u32(bytes + 4) != 2)
        gltf_fail(STATUS_UNSUPPORTED, "the GLB has version %u; only version 2 is read", read_u32(bytes + 4));
    if (read_u32(bytes + 8) != size)
        gltf_fail(STATUS_INVALID, "the GLB says it has %u bytes, but it has %zu", read_u32(bytes + 8), size);
    uint64_t json_size = read_u32(bytes + 12);
    if (read_u32(bytes + 16) != 0x4e4f534a)
        gltf_fail(STATUS_INVALID, "the GLB's first chunk is not JSON");
    if (20 + json_size > size)
        gltf_fail(STATUS_INVALID, "the GLB's JSON chunk says it has %llu bytes; the file ends before",
                  (unsigned long long)json_size);
    glb_chunks chunks = {(const char *)bytes + 20, (size_t)json_size, 0};
    uint64_t at = 20 + json_size;
    if (at == size)
        return chunks;
    if (at + 8 > size)
        gltf_fail(STATUS_INVALID, "the GLB ends within a chunk header");
    uint64_t binary_size = read_u32(bytes + at);
    if (at + 8 + binary_size > size)
        gltf_fail(STATUS_INVALID, "the GLB's second chunk says it has %llu bytes; the file ends before",
                  (unsigned long long)binary_size);
    if (read_u32(bytes + at + 4) == 0x004e4942)
        chunks.binary_size = (size_t)binary_size;
    return chunks;
}

/* One pass over the text, without recursion: nothing deep or vast reaches a parser. */
static void check_json_shape(const char *text, size_t size)
{
    if (size > max_json_bytes)
        gltf_fail(STATUS_LIMIT, "the JSON has %zu bytes; the most is %zu", size, max_json_bytes);
    int depth = 0;
    size_t values = 0;
    bool is_string = false;
    for (size_t i = 0; i < size; i++) {
        char c = text[i];
        if (is_string) {
            if (c == '\\')
                i++;
            else if (c == '"')
                is_string = false;
        } else if (c == '"') {
            is_string = true;
        } else if (c == '[' || c == '{') {
            values++;
            if (++depth > max_json_depth)
                gltf_fail(STATUS_LIMIT, "the JSON is nested more than %d deep", max_json_depth);
        } else if (c == ']' || c == '}') {
            depth--;
        } else if (c == ',') {
            values++;
        }
    }
    if (values > max_json_values)
        gltf_fail(STATUS_LIMIT, "the JSON holds more than %zu values", max_json_values);
}

static const char *const supported_extensions[] = {
    "KHR_lights_punctual",      "KHR_materials_transmission", "KHR_materials_volume",
    "KHR_materials_dispersion", "KHR_materials_ior",          "KHR_materials_emissive_strength",
    "KHR_materials_specular",   "KHR_mesh_quantization",
};

static bool is_supported(const std::string &extension)
{
    for (const char *known : supported_extensions)
        if (extension == known)
            return true;
    return false;
}

static const json &list(const json &root, const char *name, size_t limit)
{
    static const json none = json::array();
    auto found = root.find(name);
    if (found == root.end())
        return none;
    if (!found->is_array())
        gltf_fail(STATUS_INVALID, "\"%s\" is not a list", name);
    if (found->size() > limit)
        gltf_fail(STATUS_LIMIT, "\"%s\" has %zu entries; the most is %zu", name, found->size(), limit);
    for (size_t i = 0; i < found->size(); i++)
        if (!(*found)[i].is_object())
            gltf_fail(STATUS_INVALID, "\"%s\"[%zu] is not an object", name, i);
    return *found;
}

/* A non-negative integer member. */
static uint64_t unsigned_member(const json &object, const char *name, bool is_required, uint64_t fallback,
                                const std::string &where)
{
    auto found = object.find(name);
    if (found == object.end() && !is_required)
        return fallback;
    if (found == object.end() || !found->is_number_unsigned())
        gltf_fail(STATUS_INVALID, "%s: \"%s\" is %s", where.c_str(), name,
                  found == object.end() ? "missing" : "not a whole number of 0 or more");
    return found->get<uint64_t>();
}

static void check_extensions(const json &root)
{
    auto required = root.find("extensionsRequired");
    if (required == root.end())
        return;
    if (!required->is_array())
        gltf_fail(STATUS_INVALID, "\"extensionsRequired\" is not a list");
    for (const json &entry : *required) {
        if (!entry.is_string())
            gltf_fail(STATUS_INVALID, "\"extensionsRequired\" holds something that is not a name");
        std::string extension = entry.get<std::string>();
        if (is_supported(extension))
            continue;
        bool is_compressed =
            extension == "KHR_draco_mesh_compression" || extension == "EXT_meshopt_compression";
        gltf_fail(STATUS_UNSUPPORTED, "the file requires the extension %s, which is not supported%s",
                  gltf_quoted(extension).c_str(), is_compressed ? "; save it without mesh compression" : "");
    }
}

static void check_buffers(const json &root, size_t binary_size)
{
    const json &buffers = list(root, "buffers", 4096);
    uint64_t total = 0;
    std::vector<uint64_t> lengths;
    for (size_t i = 0; i < buffers.size(); i++) {
        std::string where = "buffer " + std::to_string(i);
        uint64_t length = unsigned_member(buffers[i], "byteLength", true, 0, where);
        auto uri = buffers[i].find("uri");
        if (uri != buffers[i].end() && !uri->is_string())
            gltf_fail(STATUS_INVALID, "%s: \"uri\" is not a string", where.c_str());
        /* Only the first may be the GLB's second chunk; more would each take a copy of it. */
        if (uri == buffers[i].end() && (i > 0 || binary_size == 0))
            gltf_fail(STATUS_INVALID, "%s has no \"uri\", and no binary chunk stands for it", where.c_str());
        if (uri == buffers[i].end() && length > binary_size)
            gltf_fail(STATUS_INVALID, "%s says it has %llu bytes, but the binary chunk has %zu",
                      where.c_str(), (unsigned long long)length, binary_size);
        if (length == 0 || length > SCENE_MAX_FILE_BYTES || (total += length) > SCENE_MAX_FILE_BYTES)
            gltf_fail(length == 0 ? STATUS_INVALID : STATUS_LIMIT,
                      "%s has %llu bytes; all buffers together may have 1 to %llu", where.c_str(),
                      (unsigned long long)length, (unsigned long long)SCENE_MAX_FILE_BYTES);
        lengths.push_back(length);
    }
    const json &views = list(root, "bufferViews", max_list);
    for (size_t i = 0; i < views.size(); i++) {
        std::string where = "buffer view " + std::to_string(i);
        uint64_t buffer = unsigned_member(views[i], "buffer", true, 0, where);
        uint64_t offset = unsigned_member(views[i], "byteOffset", false, 0, where);
        uint64_t length = unsigned_member(views[i], "byteLength", true, 0, where);
        if (buffer >= lengths.size())
            gltf_fail(STATUS_INVALID, "%s: there is no buffer %llu", where.c_str(),
                      (unsigned long long)buffer);
        if (length == 0 || offset > lengths[buffer] || length > lengths[buffer] - offset)
            gltf_fail(STATUS_INVALID,
                      "%s: %llu bytes from %llu on do not lie within buffer %llu of %llu bytes",
                      where.c_str(), (unsigned long long)length, (unsigned long long)offset,
                      (unsigned long long)buffer, (unsigned long long)lengths[buffer]);
    }
    const json &images = list(root, "images", SCENE_MAX_MATERIALS);
    for (size_t i = 0; i < images.size(); i++) {
        std::string where = "image " + std::to_string(i);
        uint64_t view = unsigned_member(images[i], "bufferView", false, 0, where);
        if (images[i].contains("bufferView") && view >= views.size())
            gltf_fail(STATUS_INVALID, "%s: there is no buffer view %llu", where.c_str(),
                      (unsigned long long)view);
    }
}

/* tinygltf's versions differ in what they make of a number that is not one: 0, a wrapped int, or an error. */
static void check_accessors(const json &root)
{
    const json &accessors = list(root, "accessors", max_list);
    for (size_t i = 0; i < accessors.size(); i++) {
        std::string where = "accessor " + std::to_string(i);
        unsigned_member(accessors[i], "byteOffset", false, 0, where);
        unsigned_member(accessors[i], "count", true, 0, where);
        unsigned_member(accessors[i], "bufferView", false, 0, where);
        auto sparse = accessors[i].find("sparse");
        if (sparse == accessors[i].end())
            continue;
        where += ", sparse";
        if (!sparse->is_object())
            gltf_fail(STATUS_INVALID, "%s is not an object", where.c_str());
        if (unsigned_member(*sparse, "count", true, 0, where) > SCENE_MAX_VERTICES)
            gltf_fail(STATUS_LIMIT, "%s: \"count\" is beyond %u", where.c_str(), SCENE_MAX_VERTICES);
        for (const char *part : {"indices", "values"}) {
            auto found = sparse->find(part);
            if (found == sparse->end() || !found->is_object())
                gltf_fail(STATUS_INVALID, "%s has no \"%s\"", where.c_str(), part);
            unsigned_member(*found, "bufferView", true, 0, where);
            if (unsigned_member(*found, "byteOffset", false, 0, where) > SCENE_MAX_FILE_BYTES)
                gltf_fail(STATUS_INVALID, "%s: \"byteOffset\" is beyond any buffer", where.c_str());
        }
    }
}

static void check_json(const char *text, size_t size, size_t binary_size)
{
    json root;
    try {
        root = json::parse(text, text + size);
    } catch (const json::exception &problem) {
        gltf_fail(STATUS_INVALID, "the JSON is malformed: %s", gltf_quoted(problem.what()).c_str());
    }
    if (!root.is_object())
        gltf_fail(STATUS_INVALID, "the JSON is not an object");
    auto asset = root.find("asset");
    std::string version;
    if (asset != root.end() && asset->is_object() && asset->contains("version") &&
        (*asset)["version"].is_string())
        version = (*asset)["version"].get<std::string>();
    if (version.compare(0, 2, "2.") != 0)
        gltf_fail(STATUS_UNSUPPORTED, "it is glTF version %s; only version 2 is read",
                  gltf_quoted(version).c_str());
    check_extensions(root);
    check_buffers(root, binary_size);
    check_accessors(root);
    list(root, "nodes", SCENE_MAX_NODES);
    list(root, "scenes", max_list);
    list(root, "materials", SCENE_MAX_MATERIALS);
    list(root, "textures", max_list);
    list(root, "samplers", max_list);
    list(root, "cameras", max_list);
    list(root, "animations", max_list);
    list(root, "skins", max_list);
    const json &meshes = list(root, "meshes", max_list);
    for (size_t i = 0; i < meshes.size(); i++) {
        const json &primitives = list(meshes[i], "primitives", max_list);
        if (primitives.empty())
            gltf_fail(STATUS_INVALID, "mesh %zu has no primitives", i);
        for (size_t j = 0; j < primitives.size(); j++)
            if (!primitives[j].contains("attributes") || !primitives[j]["attributes"].is_object())
                gltf_fail(STATUS_INVALID, "mesh %zu, primitive %zu has no \"attributes\"", i, j);
    }
}

/* ---- parsing ------------------------------------------------------------------------------------------ */

/* tinygltf joins what we give it as the scene's folder with a buffer's uri. This stands for the folder, so
 * that our callbacks get the uri back whole. */
static const std::string folder_mark = "scene-folder";

/* An error is kept here: tinygltf would replace it by one that says less. */
struct file_access {
    gltf_folder *folder;
    bool has_failed;
    gltf_error error;
};

static bool file_exists(const std::string &path, void *)
{
    return path.compare(0, folder_mark.size() + 1, folder_mark + "/") == 0;
}

static std::string expand_path(const std::string &path, void *)
{
    return path;
}

static bool read_whole_file(std::vector<unsigned char> *bytes, std::string *message, const std::string &path,
                            void *user)
{
    file_access *access = (file_access *)user;
    try {
        *bytes = access->folder->read(path.substr(folder_mark.size() + 1));
        return true;
    } catch (const gltf_error &error) {
        if (!access->has_failed)
            access->error = error;
        access->has_failed = true;
        *message = error.message;
        return false;
    }
}

static bool write_whole_file(std::string *, const std::string &, const std::vector<unsigned char> &, void *)
{
    return false;
}

/* Keeps the bytes of an embedded image as they are; those in a buffer view are found there later. */
static bool keep_image(tinygltf::Image *image, const int, std::string *, std::string *, int, int,
                       const unsigned char *bytes, int size, void *)
{
    if (image->bufferView < 0)
        image->image.assign(bytes, bytes + size);
    return true;
}

/* Since tinygltf 2.9 a size is asked for before a file is read; our reading checks sizes itself. */
template <typename Callbacks>
static auto set_size_callback(Callbacks &callbacks, int) -> decltype(callbacks.GetFileSizeInBytes, void())
{
    callbacks.GetFileSizeInBytes = [](size_t *size, std::string *, const std::string &, void *) {
        *size = 1;
        return true;
    };
}

template <typename Callbacks> static void set_size_callback(Callbacks &, long)
{
}

static void add_warnings(gltf_document &document, const std::string &text)
{
    size_t start = 0;
    while (start < text.size()) {
        size_t end = text.find('\n', start);
        end = end == std::string::npos ? text.size() : end;
        if (end > start)
            document.warnings.push_back(text.substr(start, end - start));
        start = end + 1;
    }
}

void gltf_parse(gltf_document &document, const unsigned char *bytes, size_t size)
{
    bool is_glb = size >= 4 && !memcmp(bytes, "glTF", 4);
    glb_chunks chunks = is_glb ? check_glb(bytes, size) : glb_chunks{(const char *)bytes, size, 0};
    check_json_shape(chunks.json, chunks.json_size);
    check_json(chunks.json, chunks.json_size, chunks.binary_size);

    tinygltf::TinyGLTF parser;
    file_access access = {&document.folder, false, {STATUS_OK, ""}};
    tinygltf::FsCallbacks callbacks = {};
    callbacks.FileExists = file_exists;
    callbacks.ExpandFilePath = expand_path;
    callbacks.ReadWholeFile = read_whole_file;
    callbacks.WriteWholeFile = write_whole_file;
    callbacks.user_data = &access;
    set_size_callback(callbacks, 0);
    parser.SetFsCallbacks(callbacks);
    parser.SetImageLoader(keep_image, nullptr);

    std::string error, warning;
    bool is_parsed = is_glb ? parser.LoadBinaryFromMemory(&document.model, &error, &warning, bytes,
                                                          (unsigned)size, folder_mark)
                            : parser.LoadASCIIFromString(&document.model, &error, &warning,
                                                         (const char *)bytes, (unsigned)size, folder_mark);
    if (!is_parsed && access.has_failed)
        throw access.error;
    if (!is_parsed)
        gltf_fail(STATUS_INVALID, "the glTF is malformed: %s", gltf_quoted(error).c_str());
    add_warnings(document, error);
    add_warnings(document, warning);
    for (const std::string &extension : document.model.extensionsUsed)
        if (!is_supported(extension))
            document.warnings.push_back("the extension " + gltf_quoted(extension) +
                                        " is not supported and was ignored");
}
