/* gltf_document.hpp: a glTF file read, checked and parsed, and checked access to what its accessors hold.
 *
 * Everything in a file is hostile until it was checked here. Before tinygltf sees a byte: GLB framing, JSON
 * nesting and size, extensionsRequired, list sizes, buffers and buffer views. After it: every accessor when
 * it is read, before memory is taken for it. Failures are thrown as gltf_error; gltf_import.cpp turns them
 * into a struct error. Internal to core/scene.
 */
#ifndef CAUSTIC_GLTF_DOCUMENT_HPP
#define CAUSTIC_GLTF_DOCUMENT_HPP

#include <cstdint>
#include <string>
#include <vector>

#include "tinygltf_config.hpp"

extern "C" {
#include "scene.h"
}

struct gltf_error {
    enum status status;
    std::string message;
};

[[noreturn]] void gltf_fail(enum status status, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/* A name from the file, fit for an error text. */
std::string gltf_quoted(const std::string &name);

/* Reads files of one folder and its subfolders, nothing else. */
class gltf_folder {
  public:
    /* No folder: every read is refused. */
    gltf_folder() = default;
    explicit gltf_folder(std::string real_path) : real_path_(std::move(real_path))
    {
    }

    /* `uri` as it stands in the file, %XX decoded. */
    std::vector<unsigned char> read(const std::string &uri);

  private:
    std::string real_path_;   /* after realpath, without a trailing slash; empty: none */
    uint64_t bytes_read_ = 0; /* of all files, against SCENE_MAX_FILE_BYTES */
};

struct gltf_document {
    tinygltf::Model model;
    gltf_folder folder;
    std::vector<std::string> warnings; /* of the parser */
    mutable uint64_t values_read = 0;  /* numbers out of accessors, against a limit: a small file can name the
                                          same  accessor a million times */
};

/* Whole file at `path`; refuses what is not a regular file or passes SCENE_MAX_FILE_BYTES. */
std::vector<unsigned char> gltf_read_file(const std::string &path);

/* GLB or JSON, by its first bytes. document.folder is set by the caller. */
void gltf_parse(gltf_document &document, const unsigned char *bytes, size_t size);

/* ---- accessors ---------------------------------------------------------------------------------------- */

/* The accessor, when it exists, is of `type` (TINYGLTF_TYPE_*), and its count is at most `limit`. `what`
 * names the use in errors: "mesh \"x\", primitive 0, POSITION". */
const tinygltf::Accessor &gltf_accessor(const gltf_document &document, int accessor, int type, size_t limit,
                                        const std::string &what);

/* All elements as floats, normalised integers converted, sparse values applied; tight. */
std::vector<float> gltf_read_floats(const gltf_document &document, int accessor, int type, size_t limit,
                                    const std::string &what);

/* Unsigned integer scalars. */
std::vector<uint32_t> gltf_read_indices(const gltf_document &document, int accessor, size_t limit,
                                        const std::string &what);

#endif
