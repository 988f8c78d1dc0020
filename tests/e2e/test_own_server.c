/* A server of a program's own: it is there when it is ready, and gone whatever becomes of the program. */
#define _GNU_SOURCE
#include <signal.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "clients/lib/client.h"
#include "clients/lib/server_process.h"
#include "tests/support/check.h"

static struct error error;
static char program[4096];

static struct server_process *start(const char *const *arguments)
{
    struct server_process *server = server_process_start(
        &(struct server_process_params){.program = program, .arguments = arguments}, &error);
    if (!server)
        fail_msg("%s", error.message);
    return server;
}

static void folder_of(const char *address, char *folder, size_t size)
{
    snprintf(folder, size, "%s", address + strlen("unix:"));
    *strrchr(folder, '/') = 0;
}

static bool ends(pid_t pid, double seconds)
{
    for (int i = 0; i < (int)(seconds * 100); i++) {
        if (kill(pid, 0) != 0)
            return true;
        nanosleep(&(struct timespec){.tv_nsec = 10000000}, NULL);
    }
    return false;
}

static void serves_and_stops(void **state)
{
    (void)state;
    char folder[128];
    struct server_process *server = start(NULL), *second = start(NULL);
    assert_string_not_equal(server_process_address(server), server_process_address(second));
    folder_of(server_process_address(server), folder, sizeof folder);
    struct client *client =
        client_connect(&(struct client_params){.address = server_process_address(server)}, &error);
    assert_non_null(client);
    assert_true(client_ping(client, &error));
    client_destroy(&client);
    assert_true(server_process_is_alive(server, &error));
    assert_true(server_process_stop(&server, &error));
    assert_null(server);
    assert_int_not_equal(access(folder, F_OK), 0);
    assert_true(server_process_is_alive(second, &error));
    assert_true(server_process_stop(&second, &error));
}

static void what_cannot_start_says_why(void **state)
{
    (void)state;
    struct server_process_params params = {.program = "/nowhere/causticd"};
    assert_null(server_process_start(&params, &error));
    assert_non_null(strstr(error.message, "/nowhere/causticd"));
    params = (struct server_process_params){.program = program, .scene = "no-such-scene"};
    assert_null(server_process_start(&params, &error));
    assert_non_null(strstr(error.message, "ended with status 1"));
    assert_non_null(strstr(error.message, "no-such-scene"));
    params = (struct server_process_params){.program = "/usr/bin/yes", .scene = "--version"};
    assert_null(server_process_start(&params, &error));
    assert_non_null(strstr(error.message, "status 0"));
    /* Writes and writes, and is never ready. */
    params = (struct server_process_params){
        .program = "/usr/bin/yes", .arguments = (const char *const[]){"--", NULL}, .ready_ms = 200};
    params.scene = "--";
    assert_null(server_process_start(&params, &error));
    assert_int_equal(error.status, STATUS_LIMIT);
}

/* The fake renderer loses its device at this seed, which ends the server. */
static void a_death_is_explained(void **state)
{
    (void)state;
    struct server_process *server = start(NULL);
    struct client *client =
        client_connect(&(struct client_params){.address = server_process_address(server)}, &error);
    assert_non_null(client);
    uint32_t view = 0;
    assert_true(client_view_create(client, 16, 16, &view, &error));
    assert_true(client_view_set(client, view, "seed", "2147483647", &error));
    struct client_frame *frame =
        client_render(client, view, &(struct client_render_params){.channels = 1}, &error);
    assert_null(frame);
    client_destroy(&client);
    bool is_alive = true;
    for (int i = 0; i < 500 && is_alive; i++) {
        nanosleep(&(struct timespec){.tv_nsec = 10000000}, NULL);
        is_alive = server_process_is_alive(server, &error);
    }
    assert_false(is_alive);
    assert_non_null(strstr(error.message, "ended with status 1"));
    assert_non_null(strstr(error.message, "error: the Vulkan device is lost"));
    assert_false(server_process_stop(&server, &error));
    assert_null(server);
}

/* A program that has a server dies of `number`; the server and its folder go with it. */
static void die_of(int number)
{
    int tell[2];
    assert_int_equal(pipe(tell), 0);
    pid_t child = fork();
    assert_true(child >= 0);
    if (child == 0) {
        signal(number, SIG_DFL); /* a shell starts background jobs with some ignored */
        struct server_process *server =
            server_process_start(&(struct server_process_params){.program = program}, &error);
        if (!server)
            _exit(1);
        const char *address = server_process_address(server);
        ssize_t told = write(tell[1], address, strlen(address) + 1);
        for (;;)
            if (told <= 0)
                _exit(2);
            else
                pause();
    }
    close(tell[1]);
    char address[128] = "", folder[128], command[256];
    assert_true(read(tell[0], address, sizeof address - 1) > 0);
    close(tell[0]);
    folder_of(address, folder, sizeof folder);
    struct client *client = client_connect(&(struct client_params){.address = address}, &error);
    assert_non_null(client);
    client_destroy(&client);
    snprintf(command, sizeof command, "/proc/%d/task/%d/children", (int)child, (int)child);
    FILE *children = fopen(command, "r");
    int server = 0;
    if (children) {
        assert_int_equal(fscanf(children, "%d", &server), 1);
        fclose(children);
    }
    kill(child, number);
    int status = 0;
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_true(WIFSIGNALED(status));
    assert_int_equal(WTERMSIG(status), number);
    if (server)
        assert_true(ends(server, 10));
    assert_null(client_connect(&(struct client_params){.address = address}, &error));
    if (number != SIGKILL)
        assert_int_not_equal(access(folder, F_OK), 0);
    else {
        snprintf(command, sizeof command, "rm -r %s", folder);
        assert_int_equal(system(command), 0);
    }
}

static void goes_with_its_program(void **state)
{
    (void)state;
    die_of(SIGINT);
    die_of(SIGTERM);
    die_of(SIGKILL);
}

int main(void)
{
    const char *programs = getenv("CAUSTICD_BIN_DIR");
    if (!programs)
        skip_program("CAUSTICD_BIN_DIR is not set: run the tests through ctest");
    snprintf(program, sizeof program, "%s/causticd-fake", programs);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(serves_and_stops), cmocka_unit_test(what_cannot_start_says_why),
        cmocka_unit_test(a_death_is_explained), cmocka_unit_test(goes_with_its_program)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
