/* The messages of the protocol: golden dumps, round trips, truncation, hostile bytes. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cmocka.h>

#include "protocol/protocol.h"

static struct protocol_message message, again;
static uint8_t encoded[PROTOCOL_HEADER_BYTES + PROTOCOL_MAX_HELLO_BYTES + 64];

/* Bytes of protocol/golden/NAME.hex: hexadecimal with comments behind #. */
static size_t read_golden(const char *name, uint8_t *bytes, size_t capacity)
{
    const char *folder = getenv("CAUSTICD_SOURCE_DIR");
    char path[1024], line[512];
    snprintf(path, sizeof path, "%s/protocol/golden/%s.hex", folder ? folder : ".", name);
    for (char *c = path + strlen(path) - strlen(name) - 4; *c; c++)
        *c = (char)(*c >= 'A' && *c <= 'Z' ? *c + 32 : *c);
    FILE *file = fopen(path, "r");
    if (!file)
        fail_msg("%s is missing", path);
    size_t count = 0;
    while (fgets(line, sizeof line, file)) {
        line[strcspn(line, "#\n")] = 0;
        for (char *at = strtok(line, " "); at; at = strtok(NULL, " ")) {
            assert_true(count < capacity && strlen(at) == 2);
            bytes[count++] = (uint8_t)strtoul(at, NULL, 16);
        }
    }
    fclose(file);
    return count;
}

static enum protocol_side sender(uint16_t type)
{
    return type >= 128 ? PROTOCOL_SERVER : PROTOCOL_CLIENT;
}

static bool decode(const uint8_t *bytes, struct protocol_message *target, struct error *error)
{
    struct protocol_header header;
    uint16_t type = (uint16_t)(bytes[4] | bytes[5] << 8);
    return protocol_header_read(bytes, sender(type), &header, error) &&
           protocol_decode(&header, bytes + PROTOCOL_HEADER_BYTES, target, error);
}

/* Reads the golden message `name`, checks that it is encoded back into the same bytes, leaves it in
 * `message`. */
static void take_golden(const char *name)
{
    static uint8_t bytes[4096];
    struct error error;
    size_t size = read_golden(name, bytes, sizeof bytes);
    if (!decode(bytes, &message, &error))
        fail_msg("%s: %s", name, error.message);
    assert_int_equal(message.header.length + PROTOCOL_HEADER_BYTES, size);
    assert_string_equal(protocol_type_name(message.header.type), name);
    size_t written = protocol_encode(&message, encoded, sizeof encoded, &error);
    assert_int_equal(written, size);
    assert_memory_equal(encoded, bytes, size);
}

static void assert_text(struct protocol_text text, const char *expected)
{
    if (!protocol_text_equals(text, expected))
        fail_msg("\"%.*s\" where \"%s\" belongs", text.length, text.bytes, expected);
}

static void assert_vector(const float *values, float x, float y, float z)
{
    assert_true(values[0] == x && values[1] == y && values[2] == z);
}

static void golden_requests(void **state)
{
    (void)state;
    take_golden("CHOOSE");
    assert_int_equal(message.header.request, 1);
    assert_int_equal(message.header.sequence, 1);
    assert_int_equal(message.choose.major, 1);
    assert_int_equal(message.choose.minor, 0);
    assert_int_equal(message.choose.features, PROTOCOL_FEATURE_ZSTD | PROTOCOL_FEATURE_F16);
    assert_text(message.choose.client, "example");
    take_golden("PING");
    assert_int_equal(message.header.length, 0);
    take_golden("VIEW_CREATE");
    assert_int_equal(message.size.width, 480);
    assert_int_equal(message.size.height, 270);
    take_golden("VIEW_RESIZE");
    assert_int_equal(message.size.view, 7);
    assert_int_equal(message.size.width, 640);
    assert_int_equal(message.size.height, 360);
    take_golden("VIEW_DESTROY");
    assert_int_equal(message.view.view, 7);
    take_golden("VIEW_SHARE");
    assert_int_equal(message.share.view, 7);
    assert_true(message.share.shared);
    take_golden("VIEW_CAMERA");
    assert_int_equal(message.camera.view, 7);
    assert_vector(message.camera.camera.eye, 0, 1, 4);
    assert_vector(message.camera.camera.at, 0, 0.5f, 0);
    assert_vector(message.camera.camera.up, 0, 1, 0);
    assert_true(message.camera.camera.fov == 45);
    take_golden("VIEW_FOLLOW");
    assert_int_equal(message.follow.view, 7);
    assert_int_equal(message.follow.camera, PROTOCOL_BY_NAME);
    assert_text(message.follow.name, "main");
    take_golden("VIEW_TIME");
    assert_int_equal(message.time.view, 7);
    assert_true(message.time.time == 1.5);
    take_golden("VIEW_LIGHT");
    assert_int_equal(message.light.view, 7);
    assert_int_equal(message.light.light, 0);
    assert_int_equal(message.light.overrides, PROTOCOL_LIGHT_INTENSITY);
    assert_vector(message.light.intensity, 10, 20, 30);
    take_golden("VIEW_SETTING");
    assert_int_equal(message.setting.view, 7);
    assert_int_equal(message.setting.setting, 0);
    assert_true(message.setting.value == 65536);
    take_golden("VIEW_RESET");
    assert_int_equal(message.view.view, 7);
    take_golden("RENDER");
    assert_int_equal(message.render.view, 7);
    assert_int_equal(message.render.channels, 9);
    assert_int_equal(message.render.format, PROTOCOL_F32);
    assert_int_equal(message.render.encoding, PROTOCOL_ZSTD);
    take_golden("SUBSCRIBE");
    assert_int_equal(message.render.format, PROTOCOL_F16);
    assert_int_equal(message.render.encoding, PROTOCOL_RAW);
    assert_int_equal(message.render.credit, 2);
    take_golden("UNSUBSCRIBE");
    assert_int_equal(message.view.view, 7);
    take_golden("CREDIT");
    assert_int_equal(message.credit.view, 7);
    assert_int_equal(message.credit.frames, 1);
}

static void golden_hello(void **state)
{
    (void)state;
    take_golden("HELLO");
    const struct protocol_hello *hello = &message.hello;
    assert_int_equal(message.header.request, 0);
    assert_int_equal(hello->major, 1);
    assert_int_equal(hello->minor, 0);
    assert_int_equal(hello->features, 15);
    assert_text(hello->version, "causticd 0.1.0");
    assert_text(hello->device, "llvmpipe");
    assert_text(hello->driver, "Mesa");
    assert_text(hello->tracer, "bvh");
    assert_int_equal(hello->limits.max_clients, 32);
    assert_int_equal(hello->limits.max_views, 8);
    assert_int_equal(hello->limits.max_size, 8192);
    assert_int_equal(hello->limits.max_pixels, 9437184);
    assert_int_equal(hello->limits.max_photons, 4194304);
    assert_int_equal(hello->limits.max_request_bytes, 1024);
    assert_int_equal(hello->limits.max_output_bytes, 64 << 20);
    assert_text(hello->scene, "sphere");
    assert_int_equal(hello->triangles, 20482);
    assert_true(hello->duration == 2.5);
    assert_int_equal(hello->camera_total, 1);
    assert_int_equal(hello->light_count, 1);
    assert_text(hello->lights[0].name, "lamp");
    assert_int_equal(hello->lights[0].type, PROTOCOL_LIGHT_POINT);
    assert_vector(hello->lights[0].intensity, 10, 20, 30);
    assert_vector(hello->lights[0].position, 0, 2, 0);
    assert_vector(hello->lights[0].direction, 0, -1, 0);
    assert_int_equal(hello->camera_count, 1);
    assert_text(hello->cameras[0].name, "main");
    assert_true(hello->cameras[0].fov == 45);
    assert_int_equal(hello->setting_count, 2);
    assert_text(hello->settings[0].name, "photons");
    assert_int_equal(hello->settings[0].type, PROTOCOL_INT);
    assert_true(hello->settings[0].minimum == 1 && hello->settings[0].maximum == 4194304);
    assert_true(hello->settings[0].value == 131072);
    assert_text(hello->settings[0].choices, "");
    assert_text(hello->settings[0].help, "photon budget");
    assert_text(hello->settings[1].name, "aa");
    assert_int_equal(hello->settings[1].type, PROTOCOL_CHOICE);
    assert_text(hello->settings[1].choices, "filter,none,pixel");
    assert_int_equal(hello->statistic_count, 1);
    assert_text(hello->statistics[0].name, "flux_emitted");
    assert_text(hello->statistics[0].unit, "W");
    assert_text(hello->statistics[0].help, "sent");
    assert_int_equal(hello->channel_count, 1);
    assert_text(hello->channels[0].name, "caustics");
    assert_int_equal(hello->channels[0].components, 3);
    assert_text(hello->channels[0].help, "radiance");
}

static void golden_replies(void **state)
{
    (void)state;
    take_golden("OK");
    assert_int_equal(message.header.request, 3);
    assert_int_equal(message.ok.value, 7);
    take_golden("ERROR");
    assert_int_equal(message.error.status, STATUS_INVALID);
    assert_text(message.error.text, "width: 0 is not 1 to 8192");
    take_golden("NOTICE");
    assert_int_equal(message.notice.kind, PROTOCOL_NOTICE_CLOSING);
    assert_int_equal(message.notice.status, STATUS_OK);
    assert_text(message.notice.text, "shutdown");
    take_golden("FRAME");
    const struct protocol_frame *frame = &message.frame;
    assert_int_equal(frame->view, 7);
    assert_int_equal(frame->frame, 41);
    assert_int_equal(frame->update_sequence, 11);
    assert_int_equal(frame->dropped, 0);
    assert_true(frame->time == 1.5);
    assert_vector(frame->camera.eye, 0, 1, 4);
    assert_vector(frame->camera.at, 0, 0.5f, 0);
    assert_true(frame->camera.fov == 45);
    assert_true(frame->world_to_camera[14] == -4 && frame->camera_to_clip[14] == -0.5f);
    assert_text(frame->black_reason, "");
    assert_int_equal(frame->channel_count, 1);
    assert_int_equal(frame->channels[0].channel, 0);
    assert_int_equal(frame->channels[0].format, PROTOCOL_F16);
    assert_int_equal(frame->channels[0].encoding, PROTOCOL_RAW);
    assert_int_equal(frame->channels[0].components, 3);
    assert_int_equal(frame->channels[0].width, 2);
    assert_int_equal(frame->channels[0].height, 1);
    assert_int_equal(frame->channels[0].bytes, 12);
    assert_int_equal(frame->channels[0].clamped, 1);
    assert_int_equal(frame->channels[0].not_a_number, 0);
    assert_int_equal(frame->pass_count, 1);
    assert_text(frame->passes[0].name, "trace");
    assert_int_equal(frame->passes[0].elapsed_ns, 1500000);
    assert_int_equal(frame->statistic_count, 1);
    assert_true(frame->statistics[0] == 0.75);
    assert_int_equal(frame->plan_count, 1);
    assert_text(frame->plan[0].name, "water");
    assert_false(frame->plan[0].is_used);
    assert_text(frame->plan[0].reason, "no water in the scene");
    take_golden("PART");
    assert_int_equal(message.part.view, 7);
    assert_int_equal(message.part.frame, 41);
    assert_int_equal(message.part.channel, 0);
    assert_int_equal(message.part.offset, 0);
    assert_int_equal(message.part.length, 12);
}

/* Memory that ends at a page that cannot be touched: a read past the end stops the test, in every build. */
struct fence {
    uint8_t *pages, *end;
    size_t size;
};

static struct fence fence_create(size_t size)
{
    size_t page = (size_t)sysconf(_SC_PAGESIZE), whole = (size + page - 1) / page * page;
    struct fence fence = {.size = whole + page};
    fence.pages = mmap(NULL, fence.size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    assert_true(fence.pages != MAP_FAILED);
    assert_int_equal(mprotect(fence.pages + whole, page, PROT_NONE), 0);
    fence.end = fence.pages + whole;
    return fence;
}

static void fence_destroy(struct fence *fence)
{
    munmap(fence->pages, fence->size);
}

/* Every message, cut short at every length, is refused with an error that names it, without a read past its
 * end; with a byte too many likewise. */
static void truncated_messages_are_refused(void **state)
{
    (void)state;
    struct fence fence = fence_create(8192);
    uint32_t tried = 0, messages = 0;
    for (uint16_t type = 0; type < 256; type++) {
        const char *name = protocol_type_name(type);
        if (strcmp(name, "unknown") == 0)
            continue;
        messages++;
        static uint8_t bytes[4096];
        size_t length = read_golden(name, bytes, sizeof bytes) - PROTOCOL_HEADER_BYTES;
        for (size_t cut = 0; cut <= length + 1; cut++) {
            if (cut == length || (type == PROTOCOL_PART && cut > 20))
                continue; /* the whole message; a PART with fewer bytes is a shorter PART */
            struct protocol_header header = {
                .length = (uint32_t)cut, .type = type, .request = 1, .sequence = 1};
            uint8_t *payload = fence.end - cut;
            memcpy(payload, bytes + PROTOCOL_HEADER_BYTES, cut > length ? length : cut);
            if (cut > length)
                payload[length] = 0;
            struct error error = {0};
            if (protocol_decode(&header, payload, &message, &error))
                fail_msg("%s cut to %zu of %zu bytes was accepted", name, cut, length);
            assert_ptr_equal(strstr(error.message, name), error.message);
            tried++;
        }
    }
    assert_int_equal(messages, 22);
    assert_true(tried > 900);
    fence_destroy(&fence);
}

static uint32_t random_state = 1;

static uint32_t random_u32(void)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 17;
    return random_state ^= random_state << 5;
}

/* Random and damaged payloads never crash, and whatever is accepted is encoded back into the same bytes. */
static void hostile_payloads_are_refused_or_canonical(void **state)
{
    (void)state;
    struct fence fence = fence_create(8192);
    uint32_t accepted = 0, refused = 0;
    for (uint32_t round = 0; round < 20000; round++) {
        uint16_t type;
        do
            type = (uint16_t)(random_u32() % 140);
        while (strcmp(protocol_type_name(type), "unknown") == 0);
        static uint8_t bytes[4096];
        size_t length = read_golden(protocol_type_name(type), bytes, sizeof bytes) - PROTOCOL_HEADER_BYTES;
        if (round % 4 == 0)
            length = random_u32() % 512;
        uint8_t *payload = fence.end - length;
        memcpy(payload, bytes + PROTOCOL_HEADER_BYTES, length);
        uint32_t damage = length == 0 ? 0 : round % 4 == 0 ? (uint32_t)length : random_u32() % 3;
        for (uint32_t i = 0; i < damage; i++)
            payload[random_u32() % length] = (uint8_t)random_u32();
        struct protocol_header header = {
            .length = (uint32_t)length, .type = type, .request = 9, .sequence = 8};
        struct error error = {0};
        if (!protocol_decode(&header, payload, &message, &error)) {
            assert_true(error.status != STATUS_OK && error.message[0]);
            refused++;
            continue;
        }
        accepted++;
        size_t size = protocol_encode(&message, encoded, sizeof encoded, &error);
        assert_int_equal(size, length + PROTOCOL_HEADER_BYTES);
        assert_memory_equal(encoded + PROTOCOL_HEADER_BYTES, payload, length);
    }
    assert_true(accepted > 1000 && refused > 1000);
    fence_destroy(&fence);
}

static void put_u32(uint8_t *bytes, uint32_t value)
{
    memcpy(bytes, &value, 4);
}

static void broken_framing_is_told_from_bad_requests(void **state)
{
    (void)state;
    struct error error;
    struct protocol_header header;
    uint8_t bytes[PROTOCOL_HEADER_BYTES] = {0};
    bytes[4] = PROTOCOL_VIEW_CREATE;
    put_u32(bytes, PROTOCOL_MAX_REQUEST_BYTES);
    assert_true(protocol_header_read(bytes, PROTOCOL_CLIENT, &header, &error));
    put_u32(bytes, PROTOCOL_MAX_REQUEST_BYTES + 1);
    assert_false(protocol_header_read(bytes, PROTOCOL_CLIENT, &header, &error));
    assert_int_equal(error.status, STATUS_LIMIT);
    assert_non_null(strstr(error.message, "VIEW_CREATE"));
    put_u32(bytes, 0);
    bytes[4] = PROTOCOL_FRAME;
    assert_false(protocol_header_read(bytes, PROTOCOL_CLIENT, &header, &error));
    assert_non_null(strstr(error.message, "FRAME"));
    assert_true(protocol_header_read(bytes, PROTOCOL_SERVER, &header, &error));
    /* An unknown type passes, to be skipped and answered. */
    bytes[4] = 99;
    put_u32(bytes, 10);
    assert_true(protocol_header_read(bytes, PROTOCOL_CLIENT, &header, &error));
    uint8_t payload[10] = {0};
    assert_false(protocol_decode(&header, payload, &message, &error));
    assert_int_equal(error.status, STATUS_UNSUPPORTED);
    put_u32(bytes, 0xffffffffu);
    assert_false(protocol_header_read(bytes, PROTOCOL_CLIENT, &header, &error));
    /* Flags without meaning are a bad request, not broken framing. */
    put_u32(bytes, 0);
    bytes[4] = PROTOCOL_PING;
    bytes[6] = 1;
    assert_true(protocol_header_read(bytes, PROTOCOL_CLIENT, &header, &error));
    assert_false(protocol_decode(&header, payload, &message, &error));
    assert_non_null(strstr(error.message, "flags"));
}

/* Sets `message` up, expects the encoder to refuse it with `field` in the error. */
static void refused(const char *field)
{
    struct error error = {0};
    assert_int_equal(protocol_encode(&message, encoded, sizeof encoded, &error), 0);
    if (!strstr(error.message, field))
        fail_msg("\"%s\" does not name %s", error.message, field);
}

static void bad_values_are_refused_by_name(void **state)
{
    (void)state;
    take_golden("VIEW_CAMERA");
    message.camera.camera.eye[1] = NAN;
    refused("eye");
    message.camera.camera.eye[1] = 0;
    message.camera.camera.fov = INFINITY;
    refused("fov");
    take_golden("VIEW_TIME");
    message.time.time = -INFINITY;
    refused("time");
    take_golden("VIEW_SETTING");
    message.setting.value = NAN;
    refused("value");
    take_golden("VIEW_LIGHT");
    message.light.overrides = 8;
    refused("overrides");
    take_golden("VIEW_LIGHT");
    message.light.direction[2] = NAN;
    refused("direction");
    take_golden("RENDER");
    message.render.channels = 1u << PROTOCOL_MAX_CHANNELS;
    refused("channels");
    take_golden("RENDER");
    message.render.format = 2;
    refused("format");
    take_golden("RENDER");
    message.render.encoding = 2;
    refused("encoding");
    take_golden("SUBSCRIBE");
    message.render.credit = 0;
    refused("credit");
    take_golden("VIEW_FOLLOW");
    message.follow.camera = 0;
    refused("name");
    take_golden("ERROR");
    message.error.status = STATUS_OK;
    refused("status");
    take_golden("CHOOSE");
    message.choose.client = (struct protocol_text){"\xff", 1};
    refused("client");
    message.choose.client = (struct protocol_text){"a\0b", 3};
    refused("client");
    message.choose.client = (struct protocol_text){"\xed\xa0\x80", 3}; /* a surrogate */
    refused("client");
    message.choose.client = (struct protocol_text){"\xc0\x80", 2}; /* overlong zero */
    refused("client");
    take_golden("FRAME");
    message.frame.channels[0].bytes = 11;
    refused("channels[0].bytes");
    take_golden("FRAME");
    message.frame.channels[0].width = PROTOCOL_MAX_IMAGE_SIZE + 1;
    refused("channels[0].width");
    take_golden("FRAME");
    message.frame.plan_count = PROTOCOL_MAX_PLAN_LINES + 1;
    refused("plan");
}

/* The largest HELLO and FRAME the limits allow, and the space the encoder asks for. */
static void full_messages_round_trip(void **state)
{
    (void)state;
    struct error error = {0};
    char name[32];
    memset(&message, 0, sizeof message);
    message.header = (struct protocol_header){.type = PROTOCOL_HELLO};
    struct protocol_hello *hello = &message.hello;
    hello->major = PROTOCOL_MAJOR;
    hello->scene =
        protocol_text_of("gl\xc3\xa4sern \xe2\x80\xa6 \xf0\x9f\x94\x86"); /* two, three and four bytes */
    hello->light_count = PROTOCOL_MAX_LIGHTS;
    hello->camera_count = PROTOCOL_MAX_CAMERAS;
    hello->setting_count = PROTOCOL_MAX_SETTINGS;
    hello->statistic_count = PROTOCOL_MAX_STATISTICS;
    hello->channel_count = PROTOCOL_MAX_CHANNELS;
    snprintf(name, sizeof name, "thirty-one bytes of a long name");
    for (uint32_t i = 0; i < PROTOCOL_MAX_CAMERAS; i++)
        hello->cameras[i].name = protocol_text_of(name);
    for (uint32_t i = 0; i < PROTOCOL_MAX_SETTINGS; i++) {
        hello->settings[i].help = hello->settings[i].choices = protocol_text_of(name);
        hello->settings[i].maximum = i;
    }
    for (uint32_t i = 0; i < PROTOCOL_MAX_CHANNELS; i++)
        hello->channels[i].components = 4;
    size_t wanted = protocol_encode(&message, NULL, 0, &error);
    size_t size = protocol_encode(&message, encoded, wanted, &error);
    assert_true(size == wanted && size > 20000);
    assert_true(decode(encoded, &again, &error));
    assert_int_equal(again.hello.settings[127].maximum, 127);
    assert_text(again.hello.cameras[255].name, name);
    assert_int_equal(protocol_encode(&message, encoded, wanted - 1, &error), 0);

    memset(&message, 0, sizeof message);
    message.header = (struct protocol_header){.type = PROTOCOL_FRAME, .request = 1};
    message.frame.channel_count = PROTOCOL_MAX_CHANNELS;
    message.frame.pass_count = PROTOCOL_MAX_PASSES;
    message.frame.statistic_count = PROTOCOL_MAX_STATISTICS;
    message.frame.plan_count = PROTOCOL_MAX_PLAN_LINES;
    for (uint32_t i = 0; i < PROTOCOL_MAX_CHANNELS; i++)
        message.frame.channels[i] = (struct protocol_channel){
            .components = 1, .width = 1, .height = 1, .bytes = 4, .channel = (uint8_t)i};
    message.frame.statistics[127] = NAN; /* a statistic may be anything */
    size = protocol_encode(&message, encoded, sizeof encoded, &error);
    assert_true(size > 0 && decode(encoded, &again, &error));
    assert_true(isnan(again.frame.statistics[127]));
    assert_int_equal(again.frame.channels[15].channel, 15);
}

static void texts_are_cut_between_characters(void **state)
{
    (void)state;
    char text[2000];
    memset(text, 'a', sizeof text);
    memcpy(text + 511, "\xc3\xa4", 2);
    text[1999] = 0;
    struct protocol_text cut = protocol_text_of(text);
    assert_int_equal(cut.length, 511);
    text[512] = 'b';
    cut = protocol_text_of(text);
    assert_int_equal(cut.length, 512);
    char small[4];
    protocol_text_copy(cut, small, sizeof small);
    assert_string_equal(small, "aaa");
    assert_int_equal(protocol_text_of(NULL).length, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(golden_requests),
        cmocka_unit_test(golden_hello),
        cmocka_unit_test(golden_replies),
        cmocka_unit_test(truncated_messages_are_refused),
        cmocka_unit_test(hostile_payloads_are_refused_or_canonical),
        cmocka_unit_test(broken_framing_is_told_from_bad_requests),
        cmocka_unit_test(bad_values_are_refused_by_name),
        cmocka_unit_test(full_messages_round_trip),
        cmocka_unit_test(texts_are_cut_between_characters),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
