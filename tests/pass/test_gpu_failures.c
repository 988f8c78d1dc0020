/* test_gpu_failures.c: every Vulkan call that may fail, failing once.
 *
 * A scenario uses the whole layer. It runs again and again, and each time another call reports an error
 * instead of being made. The scenario then ends with an error that says so, frees what it has, and the device
 * closes with nothing left over (the validation layer would name it).
 */
#include <string.h>

#include "core/gpu/gpu_internal.h"
#include "tests/support/check.h"
#include "tests/support/test_shaders.h"

static struct VolkDeviceTable real;
static uint32_t call_count, failing_call;
static const char *failing_name;
static VkResult injected;
static uint32_t complaint_count;

static bool fails(const char *name)
{
    if (++call_count != failing_call) {
        return false;
    }
    failing_name = name;
    return true;
}

#define CALLS(C)                                                                                             \
    C(vkAllocateMemory,                                                                                      \
      (VkDevice a, const VkMemoryAllocateInfo *b, const VkAllocationCallbacks *c, VkDeviceMemory *d),        \
      (a, b, c, d))                                                                                          \
    C(vkCreateBuffer,                                                                                        \
      (VkDevice a, const VkBufferCreateInfo *b, const VkAllocationCallbacks *c, VkBuffer *d), (a, b, c, d))  \
    C(vkBindBufferMemory, (VkDevice a, VkBuffer b, VkDeviceMemory c, VkDeviceSize d), (a, b, c, d))          \
    C(vkMapMemory,                                                                                           \
      (VkDevice a, VkDeviceMemory b, VkDeviceSize c, VkDeviceSize d, VkMemoryMapFlags e, void **f),          \
      (a, b, c, d, e, f))                                                                                    \
    C(vkCreateImage, (VkDevice a, const VkImageCreateInfo *b, const VkAllocationCallbacks *c, VkImage *d),   \
      (a, b, c, d))                                                                                          \
    C(vkBindImageMemory, (VkDevice a, VkImage b, VkDeviceMemory c, VkDeviceSize d), (a, b, c, d))            \
    C(vkCreateImageView,                                                                                     \
      (VkDevice a, const VkImageViewCreateInfo *b, const VkAllocationCallbacks *c, VkImageView *d),          \
      (a, b, c, d))                                                                                          \
    C(vkCreateShaderModule,                                                                                  \
      (VkDevice a, const VkShaderModuleCreateInfo *b, const VkAllocationCallbacks *c, VkShaderModule *d),    \
      (a, b, c, d))                                                                                          \
    C(vkCreateDescriptorSetLayout,                                                                           \
      (VkDevice a, const VkDescriptorSetLayoutCreateInfo *b, const VkAllocationCallbacks *c,                 \
       VkDescriptorSetLayout *d),                                                                            \
      (a, b, c, d))                                                                                          \
    C(vkCreatePipelineLayout,                                                                                \
      (VkDevice a, const VkPipelineLayoutCreateInfo *b, const VkAllocationCallbacks *c,                      \
       VkPipelineLayout *d),                                                                                 \
      (a, b, c, d))                                                                                          \
    C(vkCreateComputePipelines,                                                                              \
      (VkDevice a, VkPipelineCache b, uint32_t c, const VkComputePipelineCreateInfo *d,                      \
       const VkAllocationCallbacks *e, VkPipeline *f),                                                       \
      (a, b, c, d, e, f))                                                                                    \
    C(vkCreateGraphicsPipelines,                                                                             \
      (VkDevice a, VkPipelineCache b, uint32_t c, const VkGraphicsPipelineCreateInfo *d,                     \
       const VkAllocationCallbacks *e, VkPipeline *f),                                                       \
      (a, b, c, d, e, f))                                                                                    \
    C(vkCreateDescriptorPool,                                                                                \
      (VkDevice a, const VkDescriptorPoolCreateInfo *b, const VkAllocationCallbacks *c,                      \
       VkDescriptorPool *d),                                                                                 \
      (a, b, c, d))                                                                                          \
    C(vkAllocateDescriptorSets, (VkDevice a, const VkDescriptorSetAllocateInfo *b, VkDescriptorSet *c),      \
      (a, b, c))                                                                                             \
    C(vkResetDescriptorPool, (VkDevice a, VkDescriptorPool b, VkDescriptorPoolResetFlags c), (a, b, c))      \
    C(vkCreateQueryPool,                                                                                     \
      (VkDevice a, const VkQueryPoolCreateInfo *b, const VkAllocationCallbacks *c, VkQueryPool *d),          \
      (a, b, c, d))                                                                                          \
    C(vkResetCommandPool, (VkDevice a, VkCommandPool b, VkCommandPoolResetFlags c), (a, b, c))               \
    C(vkBeginCommandBuffer, (VkCommandBuffer a, const VkCommandBufferBeginInfo *b), (a, b))                  \
    C(vkEndCommandBuffer, (VkCommandBuffer a), (a))                                                          \
    C(vkResetFences, (VkDevice a, uint32_t b, const VkFence *c), (a, b, c))                                  \
    C(vkQueueSubmit2, (VkQueue a, uint32_t b, const VkSubmitInfo2 *c, VkFence d), (a, b, c, d))              \
    C(vkWaitForFences, (VkDevice a, uint32_t b, const VkFence *c, VkBool32 d, uint64_t e), (a, b, c, d, e))

#define DEFINE(name, parameters, arguments)                                                                  \
    static VKAPI_ATTR VkResult VKAPI_CALL failing_##name parameters                                          \
    {                                                                                                        \
        return fails(#name) ? injected : real.name arguments;                                                \
    }
CALLS(DEFINE)
#undef DEFINE

static void complain(void *user, enum gpu_log_level level, const char *text)
{
    (void)user;
    if (level != GPU_LOG_INFO) {
        print_error("%s\n", text);
        complaint_count++;
    }
}

static bool record_and_submit(struct gpu *gpu, struct gpu_frame **frame, struct gpu_pipeline *ramp,
                              struct gpu_raster *raster, struct gpu_buffer *list, struct gpu_buffer *read,
                              struct error *error)
{
    static const uint8_t bytes[700000];
    const uint32_t start = 1;
    const float size[2] = {8, 8};
    *frame = gpu_frame_begin(gpu, error);
    if (!*frame) {
        return false;
    }
    gpu_pass_begin(*frame, "ramp");
    const struct gpu_bind binds[] = {{.binding = 0, .access = GPU_WRITE, .buffer = list}};
    gpu_record_dispatch(
        *frame, &(struct gpu_dispatch){.pipeline = ramp, .binds = binds, .bind_count = 1, .push = &start});
    gpu_record_upload(*frame, list, 0, bytes, sizeof bytes);
    gpu_record_upload(*frame, list, 0, bytes, sizeof bytes);
    gpu_pass_end(*frame);
    const struct gpu_bind draw_binds[] = {{.binding = 2, .access = GPU_READ, .buffer = list},
                                          {.binding = 4, .access = GPU_READ_WRITE, .buffer = read}};
    gpu_record_draw(*frame, &(struct gpu_draw){.raster = raster,
                                               .binds = draw_binds,
                                               .bind_count = 2,
                                               .push = size,
                                               .vertex_count = 6,
                                               .instance_count = 1});
    gpu_record_raster_read(*frame, raster, read);
    return gpu_frame_submit(*frame, error);
}

static bool run_scenario(struct gpu *gpu, struct error *error)
{
    static const uint32_t data[1000];
    struct gpu_buffer *list = NULL, *read = NULL, *filled = NULL;
    struct gpu_pipeline *ramp = NULL;
    struct gpu_raster *raster = NULL;
    struct gpu_frame *frame = NULL;
    const struct gpu_constant constant = {.id = 0, .value = 0x3f800000};
    struct gpu_pipeline_params pipeline_params = {.name = "ramp", .binding_mask = 1, .push_bytes = 4};
    pipeline_params.spirv = test_shader_find("gpu_ramp.comp", &pipeline_params.spirv_bytes);
    struct gpu_raster_params raster_params = {.name = "rectangles",
                                              .constants = &constant,
                                              .constant_count = 1,
                                              .binding_mask = 1 << 2 | 1 << 4,
                                              .push_bytes = 8,
                                              .width = 8,
                                              .height = 8,
                                              .samples = 4};
    raster_params.vertex_spirv = test_shader_find("gpu_rectangles.vert", &raster_params.vertex_bytes);
    raster_params.fragment_spirv = test_shader_find("gpu_rectangles.frag", &raster_params.fragment_bytes);

    bool is_done =
        (list = gpu_buffer_create(gpu, &(struct gpu_buffer_params){.name = "list", .size = 700000}, error)) &&
        (read = gpu_buffer_create(
             gpu, &(struct gpu_buffer_params){.name = "read", .size = 4096, .memory = GPU_MEMORY_READBACK},
             error)) &&
        (filled = gpu_buffer_create_filled(gpu, "filled", data, sizeof data, false, error)) &&
        (ramp = gpu_pipeline_create(gpu, &pipeline_params, error)) &&
        (raster = gpu_raster_create(gpu, &raster_params, error));
    for (uint32_t i = 0; is_done && i < 4; i++) {
        is_done = record_and_submit(gpu, &frame, ramp, raster, list, read, error);
    }
    is_done = is_done && gpu_frame_wait(frame, error);
    gpu_buffer_destroy(&list);
    gpu_buffer_destroy(&read);
    gpu_buffer_destroy(&filled);
    gpu_pipeline_destroy(&ramp);
    gpu_raster_destroy(&raster);
    return is_done;
}

static struct gpu *open_gpu(void)
{
    struct error error;
    const struct gpu_params params = {.cache_dir = "cache", .validation = true, .log = complain};
    struct gpu *gpu = gpu_create(&params, &error);
    if (!gpu) {
        print_error("%s\n", error.message);
    }
    assert_non_null(gpu);
    real = gpu->vk;
#define REPLACE(name, parameters, arguments) gpu->vk.name = failing_##name;
    CALLS(REPLACE)
#undef REPLACE
    call_count = 0;
    return gpu;
}

/* Call n of the scenario reports results[n % 2]. */
static void run_all(const VkResult results[2])
{
    uint32_t failure_count = 0;
    complaint_count = 0;
    for (failing_call = 1;; failing_call++) {
        struct error error = {0};
        injected = results[failing_call % 2];
        const enum status status = injected == VK_ERROR_OUT_OF_HOST_MEMORY ? STATUS_MEMORY : STATUS_DEVICE;
        const char *text = injected == VK_ERROR_DEVICE_LOST ? "lost" : "memory";
        struct gpu *gpu = open_gpu();
        failing_name = NULL;
        const bool is_done = run_scenario(gpu, &error);
        if (!failing_name) {
            assert_true(is_done);
            gpu_destroy(&gpu);
            break;
        }
        failure_count++;
        /* A staging block that cannot be merged with others is done without. */
        if (is_done) {
            assert_true(strcmp(failing_name, "vkAllocateMemory") == 0 ||
                        strcmp(failing_name, "vkCreateBuffer") == 0 ||
                        strcmp(failing_name, "vkMapMemory") == 0 ||
                        strcmp(failing_name, "vkBindBufferMemory") == 0 ||
                        strcmp(failing_name, "vkWaitForFences") == 0);
        } else if (error.status != status || !strstr(error.message, text)) {
            print_error("%s: expected '%s', got '%s'\n", failing_name, text, error.message);
            fail();
        }
        /* The next try works, unless the device is gone; then it says so and does not hang. */
        failing_call = UINT32_MAX;
        const bool works_again = run_scenario(gpu, &error);
        failing_call = failure_count;
        assert_true(works_again == !gpu->is_lost);
        assert_true(works_again || strstr(error.message, "lost"));
        assert_int_equal(gpu_validation_count(gpu), 0);
        gpu_destroy(&gpu);
    }
    print_message("%u calls failed in turn\n", failure_count);
    assert_true(failure_count > 60);
    assert_int_equal(complaint_count, 0);
}

static void running_out_of_memory_is_survived(void **state)
{
    (void)state;
    run_all((const VkResult[2]){VK_ERROR_OUT_OF_DEVICE_MEMORY, VK_ERROR_OUT_OF_HOST_MEMORY});
}

static void losing_the_device_is_an_error(void **state)
{
    (void)state;
    run_all((const VkResult[2]){VK_ERROR_DEVICE_LOST, VK_ERROR_DEVICE_LOST});
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(running_out_of_memory_is_survived),
        cmocka_unit_test(losing_the_device_is_an_error),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
