/* server.h: what the parts of the network thread share. See docs/server.md for how they work together.
 *
 *   server.c   start, callbacks of the network, drain, end
 *   hello.c    the first message, made once
 *   session.c  a connection: bytes in, requests, replies in order
 *   output.c   a connection: messages and frames out
 *   views.c    views, their jobs, subscriptions, and who renders next
 *
 * Everything here belongs to the network thread.
 */
#ifndef CAUSTICD_SERVER_H
#define CAUSTICD_SERVER_H

#include "network.h"
#include "options.h"
#include "render_thread.h"

/* Requests of one connection that wait for the render thread; past this nothing is read from it. */
#define SESSION_MAX_JOBS 64u
/* Replies of one connection that wait for one before them; likewise. */
#define SESSION_MAX_REPLIES 256u
/* Unparsed bytes of one connection: what one read brings in while a request is incomplete. */
#define SESSION_MAX_RECEIVED 65536u
/* How long the end waits for what clients still take. */
#define DRAIN_NS 2000000000ull

struct server;
struct session;
struct view_entry;

/* ---- views.c ------------------------------------------------------------------------------------------ */

/* A connection that watches a view. */
struct subscription {
    struct subscription *next_of_view, *next_of_session;
    struct session *session;
    struct view_entry *view;
    uint32_t request; /* of its SUBSCRIBE */
    struct frame_request wanted;
    uint64_t credit;       /* frames that may still be sent */
    uint32_t dropped;      /* frames rendered and not sent since the last one sent */
    bool is_sending;       /* a frame of it is in the session's output */
    struct frame *waiting; /* the newest that is not sent yet; NULL: none */
    bool is_stale;         /* the view was updated after `waiting` was rendered */
};

struct view_entry {
    struct view_entry *previous, *next; /* a ring, in the order of creation */
    uint32_t id;
    struct session *owner; /* NULL: its connection is gone */
    bool is_created;       /* JOB_VIEW_CREATE has succeeded */
    bool is_ending;        /* JOB_VIEW_DESTROY is queued; nobody finds the view any more */
    bool is_shared;
    struct job *jobs, **jobs_end; /* waiting for the render thread, in order */
    uint32_t at_work;             /* of its jobs, those at the render thread */
    struct subscription *subscriptions;
    struct render_view render;
};

/* Checks the limits of views per connection and of sizes; then queues the creation. The reply follows. */
bool view_open(struct session *session, uint32_t width, uint32_t height, uint32_t request,
               struct error *error);
bool view_check_size(const struct server *server, uint32_t width, uint32_t height, struct error *error);
/* The session's own view, or an error that names the id. */
struct view_entry *view_find_own(struct session *session, uint32_t id, struct error *error);
/* A view the session may watch. */
struct view_entry *view_find_visible(struct session *session, uint32_t id, struct error *error);
/* Queues a job of the owner. Takes ownership of the job, whose `request` and `sequence` are set; reserves the
 * place of its reply. */
void view_queue(struct view_entry *view, struct job *job);
/* Queues the view's end after what waits already. Watchers are told now. */
void view_end(struct view_entry *view, uint32_t request);
void view_set_shared(struct view_entry *view, bool is_shared);

struct subscription *subscription_find(struct session *session, uint32_t view);
bool subscription_start(struct session *session, struct view_entry *view, uint32_t request,
                        const struct frame_request *wanted, uint32_t credit, struct error *error);
void subscription_end(struct subscription *subscription);
/* Sends the waiting frame when that is allowed now. */
void subscription_pump(struct subscription *subscription);

/* Gives the render thread its next batch when it is idle: views take turns. */
void views_schedule(struct server *server);
/* Takes what the render thread has finished. */
void views_collect(struct server *server);
/* Drops all of a session's jobs, subscriptions and views. */
void views_forget_session(struct session *session);
/* Answers what waits with an error, so that nothing is left but the batch at work. */
void views_cancel(struct server *server, const struct error *reason);
/* Frees the entries; when the render thread has ended. */
void views_destroy(struct server *server);

/* ---- output.c ----------------------------------------------------------------------------------------- */

struct output_item {
    struct output_item *next;
    size_t bytes;
    /* a frame: */
    struct frame *frame;
    uint32_t request, dropped;
    struct subscription *subscription; /* told when the frame is out; NULL: RENDER, or ended meanwhile */
    /* a message, when `frame` is NULL: `bytes` of them, with the sequence not yet set */
    uint8_t message[];
};

struct output {
    struct output_item *first, **end;
    size_t bytes;             /* waiting, with their items; frames in full until their last part is taken */
    bool has_described;       /* the first item is a frame whose FRAME was taken */
    uint32_t channel, offset; /* of its next part */
    uint32_t sequence;        /* of the next message */
};

void output_init(struct output *output);
void output_clear(struct output *output);
/* Copies the encoded message `bytes`. Out of memory aborts the connection. */
void output_message(struct session *session, const uint8_t *bytes, size_t size);
/* Takes a reference to the frame. Out of memory aborts the connection. */
void output_frame(struct session *session, struct frame *frame, uint32_t request, uint32_t dropped,
                  struct subscription *subscription);
size_t output_next(struct session *session, const uint8_t **bytes);

/* ---- session.c ---------------------------------------------------------------------------------------- */

/* A reply that must wait for those before it. */
struct reply {
    struct reply *next;
    uint32_t number;
    uint32_t request;
    bool is_ready;
    bool is_error;
    uint32_t value;
    struct error error;
};

struct session {
    struct session *previous, *next;
    uint64_t id;
    struct server *server;
    struct connection *connection;
    char peer[96];
    bool has_chosen, is_closing;
    uint64_t features;
    uint64_t opened_ns;
    uint64_t partial_ns; /* since when a message is incomplete; 0: none is */
    uint32_t last_sequence;
    uint32_t job_count; /* requests that wait for the render thread */
    uint32_t reply_count, last_reply;
    uint32_t view_count;
    struct reply *replies, **replies_end; /* in the order of the requests */
    struct subscription *subscriptions;
    struct output output;
    size_t received_size;
    uint8_t received[SESSION_MAX_RECEIVED];
};

struct session *session_create(struct server *server, struct connection *connection, const char *peer);
void session_destroy(struct session *session);
void session_receive(struct session *session, const uint8_t *bytes, size_t size);
/* Reads on after a pause, when that is allowed now. */
void session_resume(struct session *session);
void session_tick(struct session *session, uint64_t now_ns);
/* True when the output limit is passed: nothing is rendered for it. */
bool session_is_full(const struct session *session);

/* The session, unless it is gone or closing. */
struct session *session_find(struct server *server, uint64_t id);

/* Reserves the place of a reply and returns its number. 0 when out of memory: the connection is aborted. */
uint32_t reply_reserve(struct session *session, uint32_t request);
/* `error` NULL: OK with `value`. Sends every reply whose turn it is. */
void reply_fill(struct session *session, uint32_t number, uint32_t value, const struct error *error);
/* An ERROR outside that order: for RENDER. */
void session_send_error(struct session *session, uint32_t request, const struct error *error);
void session_send_notice(struct session *session, enum protocol_notice_kind kind, uint32_t view,
                         enum status status, const char *text);
/* Says why and closes, once everything before it is sent. */
void session_close(struct session *session, enum status status, const char *text);

/* ---- server.c ----------------------------------------------------------------------------------------- */

struct server {
    const struct options *options;
    const struct scene *scene;
    struct network *network;
    struct render_thread *render;
    uint32_t max_pixels; /* of a view: what options and device allow */
    uint8_t *hello;
    size_t hello_bytes;
    struct session *sessions;
    struct view_entry *views; /* whose turn is next; a ring; NULL: none */
    uint32_t last_view_id;
    uint64_t last_session_id;
    uint32_t jobs_at_work; /* at the render thread */
    bool is_draining;
    bool is_device_lost;
    uint64_t drain_end_ns;
    struct protocol_message incoming, outgoing; /* scratch for decoding and encoding */
    uint8_t bytes[NETWORK_MAX_WRITE];           /* scratch for output */
};

/* Serves until a signal or the loss of the device ends it; returns the exit status. */
int server_run(const struct options *options, const struct scene *scene);

/* hello.c: encodes HELLO into server->hello. */
bool hello_make(struct server *server, struct error *error);

#endif
