/* How the server starts and ends: command line, addresses, signals, and 500 connections later. Against the
 * server with the fake renderer. */
#define _GNU_SOURCE
#include "server_process.h"
#include "tests/support/check.h"
#include "tests/support/program.h"
#include "tests/support/wire.h"

#include "core/render/renderer.h"

#include <signal.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

static void sleep_ms(long milliseconds)
{
    nanosleep(&(struct timespec){.tv_sec = milliseconds / 1000, .tv_nsec = milliseconds % 1000 * 1000000},
              NULL);
}

/* causticd-fake with these arguments must end with `status` and have said `part`. */
#define EXPECT(status, part, ...) program_expect(status, part, NULL, "causticd-fake " __VA_ARGS__)

static void the_command_line_is_explained(void **state)
{
    (void)state;
    EXPECT(0, "Usage: causticd", "--help");
    EXPECT(0, "protocol 1.0", "--version");
    EXPECT(0, "fake", "--list-devices");
    EXPECT(2, "--frobnicate", "--frobnicate");
    EXPECT(2, "--device", "sphere --device");
    EXPECT(2, "0 to 65535", "--listen tcp:127.0.0.1:65536");
    EXPECT(2, "tcp:HOST:PORT", "--listen 127.0.0.1:7420");
    EXPECT(2, "no path", "--listen unix:");
    EXPECT(2, "auto, bvh, khr", "--tracer rasteriser");
    EXPECT(2, "1 to 1024", "--max-clients 0");
    EXPECT(2, "1 to 1024", "--max-clients -1");
    EXPECT(2, "WIDTHxHEIGHT", "--size-limit '640*480'");
    EXPECT(2, "WIDTHxHEIGHT", "--size-limit 99999999999999999999x2");
    EXPECT(2, "one scene", "sphere ring");
}

static void what_cannot_be_served_is_one_clear_line(void **state)
{
    (void)state;
    EXPECT(1, "nowhere", "nowhere --listen tcp:127.0.0.1:0");
    EXPECT(1, "/nonexistent/scene.glb", "/nonexistent/scene.glb --listen tcp:127.0.0.1:0");
    EXPECT(1, "none", "--device none --listen tcp:127.0.0.1:0");
    EXPECT(1, "--allow-remote", "--listen tcp:0.0.0.0:0");
    EXPECT(1, "/nonexistent/folder/socket", "--listen unix:/nonexistent/folder/socket");
    EXPECT(1, "--ready-file", "--listen tcp:127.0.0.1:0 --ready-file /nonexistent/folder/ready");
}

static void a_damaged_scene_file_is_refused_by_name(void **state)
{
    (void)state;
    static const struct {
        const char *bytes;
        size_t size;
    } files[] = {{"", 0},
                 {"glTF", 4},
                 {"glTF\2\0\0\0\377\377\377\377\377\377\377\377JSON", 20},
                 {"glTF\2\0\0\0\30\0\0\0\4\0\0\0JSON{}  ", 24}};
    for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
        char path[] = "/tmp/causticd-test-XXXXXX.glb";
        int fd = mkstemps(path, 4);
        assert_true(fd >= 0 && write(fd, files[i].bytes, files[i].size) == (ssize_t)files[i].size);
        close(fd);
        EXPECT(1, strrchr(path, '/') + 1, "%s --listen tcp:127.0.0.1:0", path);
        unlink(path);
    }
}

static void an_address_in_use_is_named(void **state)
{
    (void)state;
    struct server_process server;
    server_start(&server, &(struct server_params){0});
    EXPECT(1, server.tcp_address, "--listen %s", server.tcp_address);
    EXPECT(1, "another process listens", "--listen %s", server.unix_address);
    /* The socket of the running server survived that. */
    struct wire *wire = wire_open(server.unix_address);
    wire_expect_ok(wire, wire_ping(wire));
    wire_close(&wire);
    server_stop(&server);
}

static void a_stale_socket_is_replaced_and_a_file_is_not(void **state)
{
    (void)state;
    struct server_process server, second;
    server_start(&server, &(struct server_params){0});
    struct stat file;
    assert_int_equal(stat(server.socket_path, &file), 0);
    assert_int_equal(file.st_mode & 0777, 0600);
    /* Killed: the socket file stays. */
    assert_int_equal(server_wait(&server, SIGKILL, 10), 128 + SIGKILL);
    assert_int_equal(access(server.socket_path, F_OK), 0);
    server_start(&second, &(struct server_params){.arguments = {"--listen", server.unix_address}});
    struct wire *wire = wire_open(server.unix_address);
    wire_expect_ok(wire, wire_ping(wire));
    wire_close(&wire);
    server_stop(&second);
    assert_int_not_equal(access(server.socket_path, F_OK), 0);

    FILE *precious = fopen(server.socket_path, "w");
    fputs("precious", precious);
    fclose(precious);
    EXPECT(1, "not a socket", "--listen %s", server.unix_address);
    assert_int_equal(stat(server.socket_path, &file), 0);
    assert_int_equal(file.st_size, 8);
    server_clean(&server);
}

static void the_ready_file_tells_the_addresses(void **state)
{
    (void)state;
    char path[] = "/tmp/causticd-ready-XXXXXX", line[256] = "", newline[256];
    int fd = mkstemp(path);
    assert_true(fd >= 0);
    close(fd);
    struct server_process server;
    server_start(&server, &(struct server_params){.arguments = {"--ready-file", path}});
    FILE *file = fopen(path, "r");
    assert_non_null(file);
    assert_non_null(fgets(line, sizeof line, file));
    snprintf(newline, sizeof newline, "%s\n", server.tcp_address);
    assert_string_equal(line, newline);
    assert_non_null(fgets(line, sizeof line, file));
    snprintf(newline, sizeof newline, "%s\n", server.unix_address);
    assert_string_equal(line, newline);
    fclose(file);
    unlink(path);
    server_stop(&server);
}

/* A frame in flight and a queue behind it: the frame arrives, the queue is answered, the end is announced. */
static void a_signal_drains(int number)
{
    struct server_process server;
    server_start(&server, &(struct server_params){0});
    struct wire *wire = wire_open(server.unix_address), *idle = wire_open(server.tcp_address);
    uint32_t view = wire_new_view(wire, 256, 256);
    wire_expect_ok(wire, wire_setting(wire, view, SETTING_accumulate, 501));
    uint32_t first = wire_render(wire, view, 1), second = wire_render(wire, view, 1),
             time = wire_time(wire, view, 1);
    sleep_ms(100);
    kill(server.pid, number);
    wire_expect_error(wire, second, STATUS_UNSUPPORTED);
    wire_expect_error(wire, time, STATUS_UNSUPPORTED);
    assert_int_equal(wire_expect_frame(wire, first).bytes, 256 * 256 * 12);
    wire_expect_notice(wire, PROTOCOL_NOTICE_CLOSING, STATUS_OK);
    wire_expect_end(wire, 5);
    wire_expect_notice(idle, PROTOCOL_NOTICE_CLOSING, STATUS_OK);
    wire_expect_end(idle, 5);
    wire_close(&wire);
    wire_close(&idle);
    assert_int_equal(server_wait(&server, 0, 5), 0);
    assert_int_not_equal(access(server.socket_path, F_OK), 0);
    server_clean(&server);
}

static void sigterm_finishes_the_frame_in_flight(void **state)
{
    (void)state;
    a_signal_drains(SIGTERM);
    a_signal_drains(SIGINT);
}

static void draining_stops_accepting_and_waits_for_nobody_longer_than_stated(void **state)
{
    (void)state;
    struct server_process server;
    server_start(&server, &(struct server_params){0});
    /* A client with megabytes to come that reads none of them. */
    struct wire *wire = wire_open(server.unix_address);
    uint32_t view = wire_new_view(wire, 1024, 1024);
    for (int i = 0; i < 4; i++)
        wire_render(wire, view, 1);
    sleep_ms(300);
    double begin = seconds_now();
    kill(server.pid, SIGTERM);
    sleep_ms(300);
    struct sockaddr_un name = {.sun_family = AF_UNIX};
    memcpy(name.sun_path, server.socket_path, strlen(server.socket_path) + 1);
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_int_not_equal(connect(fd, (struct sockaddr *)&name, sizeof name), 0);
    close(fd);
    assert_int_equal(server_wait(&server, 0, 10), 0);
    double elapsed = seconds_now() - begin;
    assert_true(elapsed > 1.5 && elapsed < 5);
    wire_close(&wire);
    server_clean(&server);
}

static void a_second_signal_ends_at_once(void **state)
{
    (void)state;
    struct server_process server;
    server_start(&server, &(struct server_params){0});
    struct wire *wire = wire_open(server.unix_address);
    uint32_t view = wire_new_view(wire, 8, 8);
    wire_expect_ok(wire, wire_setting(wire, view, SETTING_accumulate, 20001)); /* 20 s */
    wire_render(wire, view, 0);
    sleep_ms(200);
    kill(server.pid, SIGTERM);
    sleep_ms(200);
    double begin = seconds_now();
    assert_int_equal(server_wait(&server, SIGTERM, 5), 1);
    assert_true(seconds_now() - begin < 2);
    wire_close(&wire);
    server_clean(&server);
}

static void without_descriptors_newcomers_are_told(void **state)
{
    (void)state;
    struct server_process server;
    server_start(&server, &(struct server_params){0});
    struct wire *witness = wire_open(server.unix_address);
    struct rlimit before, none;
    assert_int_equal(prlimit(server.pid, RLIMIT_NOFILE, NULL, &before), 0);
    /* The lowest number that is free is the one the next descriptor would get. */
    none = before;
    char path[64];
    struct stat link;
    for (none.rlim_cur = 0;; none.rlim_cur++) {
        snprintf(path, sizeof path, "/proc/%d/fd/%d", (int)server.pid, (int)none.rlim_cur);
        if (lstat(path, &link) != 0)
            break;
    }
    assert_int_equal(prlimit(server.pid, RLIMIT_NOFILE, &none, NULL), 0);
    for (int i = 0; i < 5; i++) {
        struct wire *newcomer = wire_connect(server.tcp_address);
        assert_non_null(
            strstr(wire_expect_notice(newcomer, PROTOCOL_NOTICE_CLOSING, STATUS_LIMIT), "descriptors"));
        wire_expect_end(newcomer, 5);
        wire_close(&newcomer);
    }
    wire_expect_ok(witness, wire_ping(witness));
    assert_int_equal(prlimit(server.pid, RLIMIT_NOFILE, &before, NULL), 0);
    struct wire *newcomer = wire_open(server.tcp_address);
    wire_expect_ok(newcomer, wire_ping(newcomer));
    wire_close(&newcomer);
    wire_close(&witness);
    server_stop(&server);
}

static void five_hundred_connections_leave_nothing(void **state)
{
    (void)state;
    struct server_process server;
    server_start(&server, &(struct server_params){0});
    struct wire *witness = wire_open(server.unix_address);
    uint64_t memory = 0;
    uint32_t descriptors = server_descriptors(&server);
    for (int i = 0; i < 500; i++) {
        struct wire *wire = wire_open(i % 2 ? server.unix_address : server.tcp_address);
        uint32_t view = wire_new_view(wire, 128, 128);
        wire_expect_ok(wire, wire_subscribe(wire, view, 1, 4));
        wire_receive(wire);
        wire_close(&wire);
        if (i == 50)
            memory = server_memory(&server);
    }
    wire_expect_ok(witness, wire_ping(witness));
    double end = seconds_now() + 10;
    while (server_descriptors(&server) != descriptors && seconds_now() < end)
        sleep_ms(10);
    assert_int_equal(server_descriptors(&server), descriptors);
    /* A connection is 70 KB and a frame of it 200 KB: one in twenty kept would show. */
    uint64_t after = server_memory(&server);
    print_message("%.1f MB after 50 connections, %.1f MB after 500\n", 1e-6 * (double)memory,
                  1e-6 * (double)after);
    assert_true(after < memory + (2u << 20));
    wire_close(&witness);
    server_stop(&server);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_command_line_is_explained),
        cmocka_unit_test(what_cannot_be_served_is_one_clear_line),
        cmocka_unit_test(a_damaged_scene_file_is_refused_by_name),
        cmocka_unit_test(an_address_in_use_is_named),
        cmocka_unit_test(a_stale_socket_is_replaced_and_a_file_is_not),
        cmocka_unit_test(the_ready_file_tells_the_addresses),
        cmocka_unit_test(sigterm_finishes_the_frame_in_flight),
        cmocka_unit_test(draining_stops_accepting_and_waits_for_nobody_longer_than_stated),
        cmocka_unit_test(a_second_signal_ends_at_once),
        cmocka_unit_test(without_descriptors_newcomers_are_told),
        cmocka_unit_test(five_hundred_connections_leave_nothing),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
