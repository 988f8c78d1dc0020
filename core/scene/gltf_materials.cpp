#include "gltf_materials.hpp"

#include <cmath>
#include <cstdlib>
#include <map>
#include <tuple>

#include "core/image/image_io.h"

/* ---- values ------------------------------------------------------------------------------------------- */

/* glTF's own ranges; what is outside is a warning, not an error, and what is no number is refused by the
 * JSON. */
static float in_range(scene_builder *builder, const std::string &what, double value, double minimum,
                      double maximum)
{
    if (value >= minimum && value <= maximum)
        return (float)value;
    double inside = value < minimum ? minimum : value > maximum ? maximum : minimum;
    scene_builder_warn(builder, "%s is %g; %g is used, the nearest it may be", what.c_str(), value, inside);
    return (float)inside;
}

static double number(const tinygltf::Value &object, const char *name, double fallback)
{
    const tinygltf::Value &value =
        object.IsObject() && object.Has(name) ? object.Get(name) : tinygltf::Value();
    return value.IsNumber() ? value.GetNumberAsDouble() : fallback;
}

/* The extension, or a value that is no object. */
static tinygltf::Value extension(const tinygltf::Material &material, const char *name)
{
    auto found = material.extensions.find(name);
    return found == material.extensions.end() ? tinygltf::Value() : found->second;
}

/* ---- textures ----------------------------------------------------------------------------------------- */

/* A scene image carries its wrapping, so one glTF image under two samplers becomes two. */
using image_key = std::tuple<int, bool, bool>;

struct texture_reader {
    const gltf_document &document;
    gltf_folder &folder;
    scene_builder *builder;
    std::map<image_key, uint32_t> known;
    uint64_t texels = 0, encoded_bytes = 0;

    uint32_t read(int texture_index, const std::string &what);
    std::vector<unsigned char> bytes(const tinygltf::Image &image);
};

std::vector<unsigned char> texture_reader::bytes(const tinygltf::Image &image)
{
    if (image.bufferView < 0 && !image.image.empty())
        return image.image;
    if (image.bufferView < 0)
        return folder.read(image.uri);
    /* gltf_parse proved that the view lies within its buffer's stated length, tinygltf that the buffer has
     * it. */
    const tinygltf::BufferView &view = document.model.bufferViews.at((size_t)image.bufferView);
    const std::vector<unsigned char> &data = document.model.buffers.at((size_t)view.buffer).data;
    if (view.byteOffset > data.size() || view.byteLength > data.size() - view.byteOffset)
        gltf_fail(STATUS_INVALID, "buffer view %d reaches past its buffer", image.bufferView);
    auto start = data.begin() + (std::ptrdiff_t)view.byteOffset;
    return std::vector<unsigned char>(start, start + (std::ptrdiff_t)view.byteLength);
}

uint32_t texture_reader::read(int texture_index, const std::string &what)
{
    const tinygltf::Model &model = document.model;
    if (texture_index < 0 || (size_t)texture_index >= model.textures.size())
        gltf_fail(STATUS_INVALID, "%s: there is no texture %d", what.c_str(), texture_index);
    const tinygltf::Texture &texture = model.textures[(size_t)texture_index];
    if (texture.source < 0 || (size_t)texture.source >= model.images.size()) {
        if (texture.source >= 0)
            gltf_fail(STATUS_INVALID, "%s: there is no image %d", what.c_str(), texture.source);
        scene_builder_warn(builder, "%s has no PNG or JPEG image; it is left out", what.c_str());
        return SCENE_NONE;
    }
    int wrap_u = TINYGLTF_TEXTURE_WRAP_REPEAT, wrap_v = TINYGLTF_TEXTURE_WRAP_REPEAT;
    if (texture.sampler >= 0 && (size_t)texture.sampler < model.samplers.size()) {
        wrap_u = model.samplers[(size_t)texture.sampler].wrapS;
        wrap_v = model.samplers[(size_t)texture.sampler].wrapT;
    }
    if (wrap_u == TINYGLTF_TEXTURE_WRAP_MIRRORED_REPEAT || wrap_v == TINYGLTF_TEXTURE_WRAP_MIRRORED_REPEAT)
        scene_builder_warn(builder, "%s: mirrored repeat is imported as repeat", what.c_str());
    bool clamp_u = wrap_u == TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE,
         clamp_v = wrap_v == TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE;

    image_key key = {texture.source, clamp_u, clamp_v};
    auto found = known.find(key);
    if (found != known.end())
        return found->second;
    std::string name = what + ", image " + std::to_string(texture.source);
    std::vector<unsigned char> encoded = bytes(model.images[(size_t)texture.source]);
    encoded_bytes += encoded.size();
    if (encoded_bytes > SCENE_MAX_FILE_BYTES)
        gltf_fail(STATUS_LIMIT, "%s: all images together have more than %llu bytes", name.c_str(),
                  (unsigned long long)SCENE_MAX_FILE_BYTES);
    image_decode_params params = {};
    params.name = name.c_str();
    params.max_size = SCENE_MAX_IMAGE_SIZE;
    params.max_texels = SCENE_MAX_TEXELS - texels;
    params.is_srgb = true;
    image_texels decoded = {};
    struct error error = {};
    if (!params.max_texels)
        gltf_fail(STATUS_LIMIT, "%s: all images together have more than %u texels", name.c_str(),
                  SCENE_MAX_TEXELS);
    if (!image_decode(encoded.data(), encoded.size(), &params, &decoded, &error)) {
        if (error.status != STATUS_UNSUPPORTED)
            gltf_fail(error.status, "%s", error.message);
        scene_builder_warn(builder, "%s; the texture is left out", error.message);
        return known[key] = SCENE_NONE;
    }
    if (decoded.nonfinite_count) {
        free(decoded.texels);
        gltf_fail(STATUS_INVALID, "%s: %llu values are not finite", name.c_str(),
                  (unsigned long long)decoded.nonfinite_count);
    }
    texels += (uint64_t)decoded.width * decoded.height;
    scene_image image = {decoded.width, decoded.height, decoded.texels, clamp_u, clamp_v};
    return known[key] = scene_builder_image(builder, &image);
}

/* ---- materials ---------------------------------------------------------------------------------------- */

static void warn_ignored(scene_builder *builder, const std::string &what, const tinygltf::Material &material)
{
    if (material.normalTexture.index >= 0)
        scene_builder_warn(builder, "%s: the normal texture is ignored", what.c_str());
    if (material.pbrMetallicRoughness.metallicRoughnessTexture.index >= 0)
        scene_builder_warn(builder, "%s: the metallic-roughness texture is ignored, its factors are used",
                           what.c_str());
    if (material.alphaMode == "BLEND" || material.alphaMode == "MASK")
        scene_builder_warn(builder, "%s: alpha mode %s is ignored, the surface is opaque", what.c_str(),
                           material.alphaMode.c_str());
    const tinygltf::TextureInfo *textures[] = {&material.pbrMetallicRoughness.baseColorTexture,
                                               &material.emissiveTexture};
    for (const tinygltf::TextureInfo *texture : textures)
        if (texture->index >= 0 && texture->extensions.count("KHR_texture_transform"))
            scene_builder_warn(builder, "%s: a texture transform is ignored", what.c_str());
}

static void read_factors(scene_builder *builder, const std::string &what, const std::vector<double> &values,
                         size_t expected, double maximum, float out[3])
{
    if (values.empty())
        return;
    if (values.size() != expected)
        gltf_fail(STATUS_INVALID, "%s has %zu numbers, not %zu", what.c_str(), values.size(), expected);
    for (size_t i = 0; i < 3; i++)
        out[i] = in_range(builder, what, values[i], 0, maximum);
}

/* Light passes through: solid where it has a thickness, else a thin wall. */
static void read_transmission(scene_builder *builder, const std::string &what,
                              const tinygltf::Material &source, scene_material &material)
{
    tinygltf::Value transmission = extension(source, "KHR_materials_transmission");
    material.transmission =
        in_range(builder, what + ": transmissionFactor", number(transmission, "transmissionFactor", 0), 0, 1);
    if (transmission.Has("transmissionTexture"))
        scene_builder_warn(builder, "%s: the transmission texture is ignored, its factor is used",
                           what.c_str());
    double ior = number(extension(source, "KHR_materials_ior"), "ior", 1.5);
    if (ior == 0) {
        scene_builder_warn(builder, "%s: an ior of 0 is imported as 1.5", what.c_str());
        ior = 1.5;
    }
    material.ior = in_range(builder, what + ": ior", ior, 1, 10);
    if (material.transmission <= 0)
        return;
    if (material.transmission < 0.5f) {
        scene_builder_warn(builder, "%s: a transmission of %g is imported as opaque", what.c_str(),
                           (double)material.transmission);
        return;
    }
    if (material.transmission < 1)
        scene_builder_warn(builder, "%s: a transmission of %g is imported as clear", what.c_str(),
                           (double)material.transmission);
    tinygltf::Value volume = extension(source, "KHR_materials_volume");
    material.kind = number(volume, "thicknessFactor", 0) > 0 ? MATERIAL_DIELECTRIC : MATERIAL_THIN;
    if (material.kind == MATERIAL_DIELECTRIC)
        material.dispersion = in_range(builder, what + ": dispersion",
                                       number(extension(source, "KHR_materials_dispersion"), "dispersion", 0),
                                       0, SCENE_MAX_DISPERSION);
    if (material.roughness > SCENE_WIDEST_LOBE)
        scene_builder_warn(builder, "%s: glass of roughness %g: its lobe is taken as narrow, which it is not",
                           what.c_str(), (double)material.roughness);
    if (number(extension(source, "KHR_materials_specular"), "specularFactor", 1) < 1)
        scene_builder_warn(builder, "%s: a specular factor on glass is ignored", what.c_str());
    double distance = number(volume, "attenuationDistance", 0);
    if (material.kind != MATERIAL_DIELECTRIC || distance <= 0)
        return;
    material.attenuation_distance = in_range(builder, what + ": attenuationDistance", distance, 1e-9, 1e9);
    if (volume.Has("attenuationColor") && volume.Get("attenuationColor").ArrayLen() >= 3)
        for (int i = 0; i < 3; i++) {
            const tinygltf::Value &value = volume.Get("attenuationColor").Get(i);
            material.attenuation_color[i] = in_range(builder, what + ": attenuationColor",
                                                     value.IsNumber() ? value.GetNumberAsDouble() : 1, 0, 1);
        }
}

static scene_material read_material(texture_reader &textures, const tinygltf::Material &source,
                                    const std::string &what, int &texcoord)
{
    scene_builder *builder = textures.builder;
    const tinygltf::PbrMetallicRoughness &pbr = source.pbrMetallicRoughness;
    scene_material material = scene_material_default(source.name.c_str());
    warn_ignored(builder, what, source);
    read_factors(builder, what + ": baseColorFactor", pbr.baseColorFactor, 4, 1, material.base_color);
    read_factors(builder, what + ": emissiveFactor", source.emissiveFactor, 3, 1e6, material.emission);
    material.metallic = in_range(builder, what + ": metallicFactor", pbr.metallicFactor, 0, 1);
    material.roughness = in_range(builder, what + ": roughnessFactor", pbr.roughnessFactor, 0, 1);
    material.double_sided = source.doubleSided;
    float strength = in_range(
        builder, what + ": emissiveStrength",
        number(extension(source, "KHR_materials_emissive_strength"), "emissiveStrength", 1), 0, 1e12);
    for (float &channel : material.emission)
        channel *= strength;

    texcoord = 0;
    if (pbr.baseColorTexture.index >= 0) {
        material.base_color_image = textures.read(pbr.baseColorTexture.index, what + ", base colour");
        texcoord = pbr.baseColorTexture.texCoord;
    }
    bool is_emissive = material.emission[0] > 0 || material.emission[1] > 0 || material.emission[2] > 0;
    if (is_emissive && source.emissiveTexture.index >= 0) {
        material.emission_image = textures.read(source.emissiveTexture.index, what + ", emission");
        if (pbr.baseColorTexture.index >= 0 && texcoord != source.emissiveTexture.texCoord)
            scene_builder_warn(builder, "%s: emission uses the base colour's texture coordinates",
                               what.c_str());
        else
            texcoord = source.emissiveTexture.texCoord;
    }

    read_transmission(builder, what, source, material);
    if (material.kind == MATERIAL_DIFFUSE && material.metallic >= 0.5f) {
        if (material.roughness <= SCENE_MIRROR_ROUGHNESS)
            material.kind = MATERIAL_MIRROR;
        else
            scene_builder_warn(builder,
                               "%s: metal of roughness %g (above %g) is imported as a diffuse receiver",
                               what.c_str(), (double)material.roughness, (double)SCENE_MIRROR_ROUGHNESS);
    }
    return material;
}

std::vector<int> gltf_add_materials(const gltf_document &document, gltf_folder &folder,
                                    scene_builder *builder)
{
    texture_reader textures = {document, folder, builder, {}};
    std::vector<int> texcoords;
    for (size_t i = 0; i < document.model.materials.size(); i++) {
        const tinygltf::Material &source = document.model.materials[i];
        std::string what =
            source.name.empty() ? "material " + std::to_string(i) : "material " + gltf_quoted(source.name);
        int texcoord = 0;
        scene_material material = read_material(textures, source, what, texcoord);
        scene_builder_material(builder, &material);
        texcoords.push_back(texcoord);
    }
    return texcoords;
}
