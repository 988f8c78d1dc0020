#include <cmath>
#include <cstring>

#include "gltf_document.hpp"

/* Elements an accessor may have that no bytes in the file stand for (all zero, or sparse over zero). */
static constexpr size_t max_unbacked = size_t(4) << 20;

/* Numbers read over a whole file: the largest scene that scene.h allows needs some 700 million. */
static constexpr uint64_t max_values = uint64_t(1) << 30;

static void count_values(const gltf_document &document, uint64_t values, const std::string &what)
{
    document.values_read += values;
    if (document.values_read > max_values)
        gltf_fail(STATUS_LIMIT, "%s: with it the file has more than %llu numbers to read", what.c_str(),
                  (unsigned long long)max_values);
}

static size_t component_bytes(int component_type, const std::string &what)
{
    switch (component_type) {
    case TINYGLTF_COMPONENT_TYPE_BYTE:
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
        return 1;
    case TINYGLTF_COMPONENT_TYPE_SHORT:
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
        return 2;
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT:
    case TINYGLTF_COMPONENT_TYPE_FLOAT:
        return 4;
    default:
        gltf_fail(STATUS_INVALID, "%s: component type %d is not one glTF has", what.c_str(), component_type);
    }
}

static size_t component_count(int type)
{
    return type == TINYGLTF_TYPE_SCALAR ? 1
           : type == TINYGLTF_TYPE_VEC2 ? 2
           : type == TINYGLTF_TYPE_VEC3 ? 3
                                        : 4;
}

/* Elements laid out in a buffer view, proved to lie within it. */
struct span {
    const unsigned char *bytes;
    size_t stride;
};

static span find_span(const gltf_document &document, int view_index, uint64_t offset, uint64_t count,
                      size_t element_bytes, bool may_stride, const std::string &what)
{
    const tinygltf::Model &model = document.model;
    if (view_index < 0 || (size_t)view_index >= model.bufferViews.size())
        gltf_fail(STATUS_INVALID, "%s: there is no buffer view %d", what.c_str(), view_index);
    const tinygltf::BufferView &view = model.bufferViews[(size_t)view_index];
    if (view.buffer < 0 || (size_t)view.buffer >= model.buffers.size())
        gltf_fail(STATUS_INVALID, "%s: buffer view %d has no buffer", what.c_str(), view_index);
    const std::vector<unsigned char> &data = model.buffers[(size_t)view.buffer].data;
    if (view.byteOffset > data.size() || view.byteLength > data.size() - view.byteOffset)
        gltf_fail(STATUS_INVALID, "%s: buffer view %d reaches past its buffer", what.c_str(), view_index);
    size_t stride = may_stride && view.byteStride ? view.byteStride : element_bytes;
    if (stride < element_bytes)
        gltf_fail(STATUS_INVALID, "%s: a stride of %zu bytes is less than an element's %zu", what.c_str(),
                  stride, element_bytes);
    /* count is at most 2^32 and stride at most 252: no overflow. */
    uint64_t needed = count ? (count - 1) * stride + element_bytes : 0;
    if (offset > view.byteLength || needed > view.byteLength - offset)
        gltf_fail(STATUS_INVALID,
                  "%s: %llu elements from byte %llu on need %llu bytes; buffer view %d has %zu", what.c_str(),
                  (unsigned long long)count, (unsigned long long)offset, (unsigned long long)needed,
                  view_index, view.byteLength);
    return {data.data() + view.byteOffset + offset, stride};
}

const tinygltf::Accessor &gltf_accessor(const gltf_document &document, int index, int type, size_t limit,
                                        const std::string &what)
{
    if (index < 0 || (size_t)index >= document.model.accessors.size())
        gltf_fail(STATUS_INVALID, "%s: there is no accessor %d", what.c_str(), index);
    const tinygltf::Accessor &accessor = document.model.accessors[(size_t)index];
    if (accessor.type != type)
        gltf_fail(STATUS_INVALID, "%s: accessor %d has the wrong number of components", what.c_str(), index);
    component_bytes(accessor.componentType, what);
    limit = limit < UINT32_MAX ? limit : UINT32_MAX;
    if (accessor.count > limit)
        gltf_fail(STATUS_LIMIT, "%s: accessor %d has %zu elements; the most is %zu", what.c_str(), index,
                  accessor.count, limit);
    if (accessor.count == 0)
        gltf_fail(STATUS_INVALID, "%s: accessor %d has no elements", what.c_str(), index);
    if (accessor.bufferView < 0 && accessor.count > max_unbacked)
        gltf_fail(STATUS_LIMIT, "%s: accessor %d has %zu elements without data; the most is %zu",
                  what.c_str(), index, accessor.count, max_unbacked);
    return accessor;
}

template <typename Number> static Number load(const unsigned char *bytes)
{
    Number value;
    memcpy(&value, bytes, sizeof value);
    return value;
}

static uint32_t load_unsigned(const unsigned char *bytes, int component_type)
{
    switch (component_type) {
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
        return *bytes;
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
        return load<uint16_t>(bytes);
    default:
        return load<uint32_t>(bytes);
    }
}

/* glTF 2.0, 3.11: signed integers lose their most negative value. */
static float load_float(const unsigned char *bytes, int component_type, bool is_normalized)
{
    switch (component_type) {
    case TINYGLTF_COMPONENT_TYPE_BYTE: {
        float value = (float)load<int8_t>(bytes);
        return is_normalized ? std::fmax(value / 127.0f, -1.0f) : value;
    }
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
        return (float)*bytes / (is_normalized ? 255.0f : 1.0f);
    case TINYGLTF_COMPONENT_TYPE_SHORT: {
        float value = (float)load<int16_t>(bytes);
        return is_normalized ? std::fmax(value / 32767.0f, -1.0f) : value;
    }
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
        return (float)load<uint16_t>(bytes) / (is_normalized ? 65535.0f : 1.0f);
    case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT:
        return (float)load<uint32_t>(bytes);
    default:
        return load<float>(bytes);
    }
}

static bool is_unsigned_type(int component_type)
{
    return component_type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE ||
           component_type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT ||
           component_type == TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT;
}

/* Calls visit(element, bytes of its value) for every value a sparse accessor replaces. */
template <typename Visit>
static void visit_sparse(const gltf_document &document, const tinygltf::Accessor &accessor,
                         size_t element_bytes, const std::string &what, Visit visit)
{
    if (!accessor.sparse.isSparse)
        return;
    int index_type = accessor.sparse.indices.componentType;
    if (!is_unsigned_type(index_type))
        gltf_fail(STATUS_INVALID, "%s: sparse indices of component type %d", what.c_str(), index_type);
    if (accessor.sparse.count < 1 || (size_t)accessor.sparse.count > accessor.count)
        gltf_fail(STATUS_INVALID, "%s: %d sparse values for %zu elements", what.c_str(),
                  accessor.sparse.count, accessor.count);
    size_t count = (size_t)accessor.sparse.count, index_bytes = component_bytes(index_type, what);
    span indices = find_span(document, accessor.sparse.indices.bufferView,
                             (uint64_t)accessor.sparse.indices.byteOffset, count, index_bytes, false, what);
    span values = find_span(document, accessor.sparse.values.bufferView,
                            (uint64_t)accessor.sparse.values.byteOffset, count, element_bytes, false, what);
    uint64_t previous = 0;
    for (size_t i = 0; i < count; i++) {
        uint64_t element = load_unsigned(indices.bytes + i * indices.stride, index_type);
        if (element >= accessor.count || (i > 0 && element <= previous))
            gltf_fail(STATUS_INVALID, "%s: sparse index %zu is %llu: not rising, or not below %zu",
                      what.c_str(), i, (unsigned long long)element, accessor.count);
        previous = element;
        visit((size_t)element, values.bytes + i * values.stride);
    }
}

std::vector<float> gltf_read_floats(const gltf_document &document, int index, int type, size_t limit,
                                    const std::string &what)
{
    const tinygltf::Accessor &accessor = gltf_accessor(document, index, type, limit, what);
    size_t width = component_count(type), bytes = component_bytes(accessor.componentType, what);
    count_values(document, accessor.count * width, what);
    span source = {nullptr, 0};
    if (accessor.bufferView >= 0)
        source = find_span(document, accessor.bufferView, accessor.byteOffset, accessor.count, width * bytes,
                           true, what);
    std::vector<float> out(accessor.count * width, 0.0f);
    auto copy = [&](size_t element, const unsigned char *from) {
        for (size_t i = 0; i < width; i++)
            out[element * width + i] =
                load_float(from + i * bytes, accessor.componentType, accessor.normalized);
    };
    for (size_t i = 0; source.bytes && i < accessor.count; i++)
        copy(i, source.bytes + i * source.stride);
    visit_sparse(document, accessor, width * bytes, what, copy);
    return out;
}

std::vector<uint32_t> gltf_read_indices(const gltf_document &document, int index, size_t limit,
                                        const std::string &what)
{
    const tinygltf::Accessor &accessor = gltf_accessor(document, index, TINYGLTF_TYPE_SCALAR, limit, what);
    if (!is_unsigned_type(accessor.componentType))
        gltf_fail(STATUS_INVALID, "%s: indices of component type %d", what.c_str(), accessor.componentType);
    size_t bytes = component_bytes(accessor.componentType, what);
    count_values(document, accessor.count, what);
    span source = {nullptr, 0};
    if (accessor.bufferView >= 0)
        source =
            find_span(document, accessor.bufferView, accessor.byteOffset, accessor.count, bytes, true, what);
    std::vector<uint32_t> out(accessor.count, 0);
    auto copy = [&](size_t element, const unsigned char *from) {
        out[element] = load_unsigned(from, accessor.componentType);
    };
    for (size_t i = 0; source.bytes && i < accessor.count; i++)
        copy(i, source.bytes + i * source.stride);
    visit_sparse(document, accessor, bytes, what, copy);
    return out;
}
