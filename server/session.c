#include "server.h"

#include <stdlib.h>
#include <string.h>

struct session *session_create(struct server *server, struct connection *connection, const char *peer)
{
    struct session *session = calloc(1, sizeof *session);
    if (!session)
        return NULL;
    session->id = ++server->last_session_id;
    session->server = server;
    session->connection = connection;
    session->opened_ns = network_now_ns();
    session->replies_end = &session->replies;
    strncpy(session->peer, peer, sizeof session->peer - 1);
    output_init(&session->output);
    session->next = server->sessions;
    if (session->next)
        session->next->previous = session;
    server->sessions = session;
    log_line(LOG_LEVEL_DEBUG, "%s connected", session->peer);
    output_message(session, server->hello, server->hello_bytes);
    return session;
}

void session_destroy(struct session *session)
{
    struct server *server = session->server;
    log_line(LOG_LEVEL_DEBUG, "%s disconnected", session->peer);
    if (session->previous)
        session->previous->next = session->next;
    else
        server->sessions = session->next;
    if (session->next)
        session->next->previous = session->previous;
    views_forget_session(session);
    output_clear(&session->output);
    while (session->replies) {
        struct reply *reply = session->replies;
        session->replies = reply->next;
        free(reply);
    }
    free(session);
    views_schedule(server);
}

struct session *session_find(struct server *server, uint64_t id)
{
    struct session *session = server->sessions;
    while (session && session->id != id)
        session = session->next;
    return session && !session->is_closing ? session : NULL;
}

bool session_is_full(const struct session *session)
{
    return session->output.bytes > session->server->options->output_limit;
}

/* ---- replies ------------------------------------------------------------------------------------------ */

static void send_message(struct session *session, const struct protocol_message *message)
{
    uint8_t bytes[PROTOCOL_HEADER_BYTES + PROTOCOL_MAX_REQUEST_BYTES];
    struct error error;
    size_t size = protocol_encode(message, bytes, sizeof bytes, &error);
    if (size) {
        output_message(session, bytes, size);
    } else {
        log_line(LOG_LEVEL_ERROR, "%s cannot be encoded: %s", protocol_type_name(message->header.type),
                 error.message);
        connection_abort(session->connection);
    }
}

void session_send_error(struct session *session, uint32_t request, const struct error *error)
{
    struct protocol_message *message = &session->server->outgoing;
    message->header = (struct protocol_header){.type = PROTOCOL_ERROR, .request = request};
    message->error =
        (struct protocol_error){.status = error->status, .text = protocol_text_of(error->message)};
    send_message(session, message);
}

void session_send_notice(struct session *session, enum protocol_notice_kind kind, uint32_t view,
                         enum status status, const char *text)
{
    struct protocol_message *message = &session->server->outgoing;
    message->header = (struct protocol_header){.type = PROTOCOL_NOTICE};
    message->notice = (struct protocol_notice){
        .kind = (uint16_t)kind, .view = view, .status = status, .text = protocol_text_of(text)};
    send_message(session, message);
}

void session_close(struct session *session, enum status status, const char *text)
{
    if (session->is_closing)
        return;
    session->is_closing = true;
    session_send_notice(session, PROTOCOL_NOTICE_CLOSING, 0, status, text);
    connection_finish(session->connection);
    views_forget_session(session);
}

uint32_t reply_reserve(struct session *session, uint32_t request)
{
    struct reply *reply = calloc(1, sizeof *reply);
    if (!reply) {
        connection_abort(session->connection);
        return 0;
    }
    if (++session->last_reply == 0)
        session->last_reply = 1;
    reply->number = session->last_reply;
    reply->request = request;
    *session->replies_end = reply;
    session->replies_end = &reply->next;
    session->reply_count++;
    return reply->number;
}

static void send_reply(struct session *session, const struct reply *reply)
{
    if (reply->is_error) {
        session_send_error(session, reply->request, &reply->error);
        return;
    }
    struct protocol_message *message = &session->server->outgoing;
    message->header = (struct protocol_header){.type = PROTOCOL_OK, .request = reply->request};
    message->ok = (struct protocol_ok){.value = reply->value};
    send_message(session, message);
}

void reply_fill(struct session *session, uint32_t number, uint32_t value, const struct error *error)
{
    struct reply *reply = session->replies;
    while (reply && reply->number != number)
        reply = reply->next;
    if (!reply)
        return;
    reply->is_ready = true;
    reply->value = value;
    reply->is_error = error != NULL;
    if (error)
        reply->error = *error;
    while (session->replies && session->replies->is_ready) {
        struct reply *first = session->replies;
        session->replies = first->next;
        if (!session->replies)
            session->replies_end = &session->replies;
        session->reply_count--;
        send_reply(session, first);
        free(first);
    }
}

/* ---- requests ----------------------------------------------------------------------------------------- */

/* The reply to a request that is answered at once, though after those before it. */
static void answer(struct session *session, uint32_t request, const struct error *error)
{
    reply_fill(session, reply_reserve(session, request), 0, error);
}

static bool choose(struct session *session, const struct protocol_choose *choose, struct error *error)
{
    if (session->has_chosen)
        return error_set(error, STATUS_INVALID, "CHOOSE: was sent before");
    if (choose->major != PROTOCOL_MAJOR || choose->minor > PROTOCOL_MINOR)
        return error_set(error, STATUS_UNSUPPORTED, "CHOOSE: version %u.%u is not spoken here, but %u.%u",
                         choose->major, choose->minor, PROTOCOL_MAJOR, PROTOCOL_MINOR);
    uint64_t unknown = choose->features & ~(uint64_t)(PROTOCOL_FEATURE_ZSTD | PROTOCOL_FEATURE_F16 |
                                                      PROTOCOL_FEATURE_LIVE | PROTOCOL_FEATURE_SHARE);
    if (unknown)
        return error_set(error, STATUS_UNSUPPORTED, "CHOOSE: features: 0x%llx are not the server's",
                         (unsigned long long)unknown);
    session->has_chosen = true;
    session->features = choose->features;
    char name[128];
    protocol_text_copy(choose->client, name, sizeof name);
    for (char *byte = name; *byte; byte++)
        if ((unsigned char)*byte < ' ' || *byte == 0x7f) /* a log line stays one line */
            *byte = '?';
    log_line(LOG_LEVEL_INFO, "%s: %s", session->peer, name[0] ? name : "a client without a name");
    return true;
}

static bool has_feature(const struct session *session, uint64_t feature, const char *name,
                        struct error *error)
{
    return session->features & feature ||
           error_set(error, STATUS_UNSUPPORTED, "%s was not among the features that CHOOSE picked", name);
}

static bool check_wanted(const struct session *session, const struct protocol_render *render,
                         struct error *error)
{
    if (render->channels >> CHANNEL_COUNT)
        return error_set(error, STATUS_INVALID, "channels: 0x%x names channels beyond the %d there are",
                         render->channels, CHANNEL_COUNT);
    return (render->format != PROTOCOL_F16 || has_feature(session, PROTOCOL_FEATURE_F16, "f16", error)) &&
           (render->encoding != PROTOCOL_ZSTD || has_feature(session, PROTOCOL_FEATURE_ZSTD, "zstd", error));
}

static struct frame_request wanted_of(const struct protocol_render *render)
{
    return (struct frame_request){.channels = render->channels,
                                  .format = (enum protocol_format)render->format,
                                  .encoding = (enum protocol_encoding)render->encoding};
}

static bool find_camera(const struct session *session, const struct protocol_follow *follow, uint32_t *camera,
                        struct error *error)
{
    const struct scene *scene = session->server->scene;
    *camera = follow->camera;
    if (follow->camera != PROTOCOL_BY_NAME)
        return follow->camera < scene->camera_count ||
               error_set(error, STATUS_NOT_FOUND, "VIEW_FOLLOW: there is no camera %u, the scene has %u",
                         follow->camera, scene->camera_count);
    for (uint32_t i = 0; i < scene->camera_count; i++)
        if (protocol_text_equals(follow->name, scene->cameras[i].name)) {
            *camera = i;
            return true;
        }
    char name[SCENE_NAME_SIZE];
    protocol_text_copy(follow->name, name, sizeof name);
    return error_set(error, STATUS_NOT_FOUND, "VIEW_FOLLOW: there is no camera named \"%s\"", name);
}

static struct view_light light_change(const struct protocol_view_light *light)
{
    struct view_light change = {.overrides = light->overrides};
    memcpy(change.intensity, light->intensity, sizeof change.intensity);
    memcpy(change.position, light->position, sizeof change.position);
    memcpy(change.direction, light->direction, sizeof change.direction);
    return change;
}

_Static_assert((int)LIGHT_OVERRIDE_INTENSITY == (int)PROTOCOL_LIGHT_INTENSITY &&
                   (int)LIGHT_OVERRIDE_POSITION == (int)PROTOCOL_LIGHT_POSITION &&
                   (int)LIGHT_OVERRIDE_DIRECTION == (int)PROTOCOL_LIGHT_DIRECTION,
               "the renderer's bits are those of the protocol");

/* Fills the job of a request that changes or renders a view; what a job needs to be valid beyond that, the
 * renderer checks. */
static bool fill_job(struct session *session, const struct protocol_message *message, struct job *job,
                     struct error *error)
{
    const struct scene *scene = session->server->scene;
    switch (message->header.type) {
    case PROTOCOL_VIEW_RESIZE:
        job->kind = JOB_RESIZE;
        job->size.width = message->size.width;
        job->size.height = message->size.height;
        return view_check_size(session->server, message->size.width, message->size.height, error);
    case PROTOCOL_VIEW_CAMERA:
        job->kind = JOB_CAMERA;
        memcpy(job->camera.eye, message->camera.camera.eye, sizeof job->camera.eye);
        memcpy(job->camera.at, message->camera.camera.at, sizeof job->camera.at);
        memcpy(job->camera.up, message->camera.camera.up, sizeof job->camera.up);
        job->camera.fov = message->camera.camera.fov;
        return true;
    case PROTOCOL_VIEW_FOLLOW:
        job->kind = JOB_FOLLOW;
        return find_camera(session, &message->follow, &job->follow, error);
    case PROTOCOL_VIEW_TIME:
        job->kind = JOB_TIME;
        job->time = message->time.time;
        return true;
    case PROTOCOL_VIEW_LIGHT:
        job->kind = JOB_LIGHT;
        job->light.index = message->light.light;
        job->light.change = light_change(&message->light);
        return message->light.light < scene->light_count ||
               error_set(error, STATUS_NOT_FOUND, "VIEW_LIGHT: there is no light %u, the scene has %u",
                         message->light.light, scene->light_count);
    case PROTOCOL_VIEW_SETTING:
        job->kind = JOB_SETTING;
        job->setting.id = (enum setting_id)message->setting.setting;
        job->setting.value = message->setting.value;
        return message->setting.setting < SETTING_COUNT ||
               error_set(error, STATUS_NOT_FOUND, "VIEW_SETTING: there is no setting %u, the server has %d",
                         message->setting.setting, SETTING_COUNT);
    case PROTOCOL_VIEW_RESET:
        job->kind = JOB_RESET;
        return true;
    default:
        job->kind = JOB_RENDER;
        job->outputs[0].request = wanted_of(&message->render);
        return check_wanted(session, &message->render, error);
    }
}

/* Requests whose reply comes from the render thread. */
static bool start_job(struct session *session, const struct protocol_message *message, struct error *error)
{
    /* Every request of this group begins with the view's id. */
    struct view_entry *view = view_find_own(session, message->view.view, error);
    if (!view)
        return false;
    struct job *job = job_create(JOB_RESET, message->header.type == PROTOCOL_RENDER ? 1 : 0);
    if (!job)
        return error_set(error, STATUS_MEMORY, "out of memory");
    if (!fill_job(session, message, job, error)) {
        job_destroy(&job);
        return false;
    }
    job->request = message->header.request;
    job->sequence = message->header.sequence;
    view_queue(view, job);
    return true;
}

enum outcome { ANSWER_OK, ANSWER_ERROR, ANSWER_LATER };

static enum outcome outcome_of(bool ok)
{
    return ok ? ANSWER_OK : ANSWER_ERROR;
}

static enum outcome subscribe(struct session *session, const struct protocol_message *message,
                              struct error *error)
{
    if (!has_feature(session, PROTOCOL_FEATURE_LIVE, "live subscription", error) ||
        !check_wanted(session, &message->render, error))
        return ANSWER_ERROR;
    struct view_entry *view = view_find_visible(session, message->render.view, error);
    struct frame_request wanted = wanted_of(&message->render);
    return outcome_of(view && subscription_start(session, view, message->header.request, &wanted,
                                                 message->render.credit, error));
}

static enum outcome add_credit(struct session *session, const struct protocol_credit *credit,
                               struct error *error)
{
    struct subscription *subscription = subscription_find(session, credit->view);
    if (!subscription)
        return outcome_of(
            error_set(error, STATUS_NOT_FOUND, "CREDIT: view %u has no subscription of yours", credit->view));
    if (subscription->credit + credit->frames > UINT32_MAX)
        return outcome_of(error_set(error, STATUS_LIMIT, "CREDIT: frames: more than %u in all", UINT32_MAX));
    subscription->credit += credit->frames;
    subscription_pump(subscription);
    return ANSWER_OK;
}

static enum outcome handle(struct session *session, const struct protocol_message *message,
                           struct error *error)
{
    uint16_t type = message->header.type;
    struct view_entry *view;
    struct subscription *subscription;
    if (!session->has_chosen && type != PROTOCOL_CHOOSE)
        return outcome_of(
            error_set(error, STATUS_INVALID, "%s: CHOOSE comes first", protocol_type_name(type)));
    if (session->server->is_draining && type != PROTOCOL_PING)
        return outcome_of(error_set(error, STATUS_UNSUPPORTED, "the server is shutting down"));
    switch (type) {
    case PROTOCOL_CHOOSE:
        return outcome_of(choose(session, &message->choose, error));
    case PROTOCOL_PING:
        return ANSWER_OK;
    case PROTOCOL_VIEW_CREATE:
        return view_open(session, message->size.width, message->size.height, message->header.request, error)
                   ? ANSWER_LATER
                   : ANSWER_ERROR;
    case PROTOCOL_VIEW_DESTROY:
        view = view_find_own(session, message->view.view, error);
        if (view)
            view_end(view, message->header.request);
        return view ? ANSWER_LATER : ANSWER_ERROR;
    case PROTOCOL_VIEW_SHARE:
        if (!has_feature(session, PROTOCOL_FEATURE_SHARE, "sharing views", error))
            return ANSWER_ERROR;
        view = view_find_own(session, message->share.view, error);
        if (view)
            view_set_shared(view, message->share.shared);
        return outcome_of(view != NULL);
    case PROTOCOL_SUBSCRIBE:
        return subscribe(session, message, error);
    case PROTOCOL_UNSUBSCRIBE:
        subscription = subscription_find(session, message->view.view);
        if (subscription)
            subscription_end(subscription);
        return outcome_of(subscription ||
                          error_set(error, STATUS_NOT_FOUND,
                                    "UNSUBSCRIBE: view %u has no subscription of yours", message->view.view));
    case PROTOCOL_CREDIT:
        return add_credit(session, &message->credit, error);
    default:
        return start_job(session, message, error) ? ANSWER_LATER : ANSWER_ERROR;
    }
}

/* One complete message. */
static void process(struct session *session, const struct protocol_header *header, const uint8_t *payload)
{
    struct protocol_message *message = &session->server->incoming;
    struct error error = {0};
    enum outcome outcome = ANSWER_ERROR;
    if (header->request == 0)
        error_set(&error, STATUS_INVALID, "header: request must not be 0");
    else if (header->sequence <= session->last_sequence)
        error_set(&error, STATUS_INVALID, "header: sequence %u does not rise, the last was %u",
                  header->sequence, session->last_sequence);
    else if (protocol_decode(header, payload, message, &error)) {
        message->header = *header;
        outcome = handle(session, message, &error);
    }
    if (header->sequence > session->last_sequence)
        session->last_sequence = header->sequence;
    if (outcome == ANSWER_ERROR)
        log_line(LOG_LEVEL_DEBUG, "%s: refused: %s", session->peer, error.message);
    /* A RENDER is answered outside the order, also when it is refused. */
    if (outcome == ANSWER_ERROR && header->type == PROTOCOL_RENDER)
        session_send_error(session, header->request, &error);
    else if (outcome != ANSWER_LATER)
        answer(session, header->request, outcome == ANSWER_OK ? NULL : &error);
}

/* ---- receiving ---------------------------------------------------------------------------------------- */

static bool is_blocked(const struct session *session)
{
    return session->job_count >= SESSION_MAX_JOBS || session->reply_count >= SESSION_MAX_REPLIES ||
           session_is_full(session);
}

static void parse(struct session *session)
{
    size_t begin = 0;
    while (!session->is_closing && !is_blocked(session) &&
           session->received_size - begin >= PROTOCOL_HEADER_BYTES) {
        const uint8_t *bytes = session->received + begin;
        struct protocol_header header;
        struct error error;
        if (!protocol_header_read(bytes, PROTOCOL_CLIENT, &header, &error)) {
            log_line(LOG_LEVEL_INFO, "%s is disconnected: %s", session->peer, error.message);
            session_close(session, error.status, error.message);
            break;
        }
        if (session->received_size - begin < PROTOCOL_HEADER_BYTES + header.length)
            break;
        process(session, &header, bytes + PROTOCOL_HEADER_BYTES);
        begin += PROTOCOL_HEADER_BYTES + header.length;
        session->partial_ns = 0;
    }
    session->received_size -= begin;
    memmove(session->received, session->received + begin, session->received_size);
    bool is_waiting = session->received_size && !is_blocked(session);
    if (!is_waiting)
        session->partial_ns = 0;
    else if (!session->partial_ns)
        session->partial_ns = network_now_ns();
    connection_pause(session->connection, is_blocked(session));
    views_schedule(session->server);
}

void session_receive(struct session *session, const uint8_t *bytes, size_t size)
{
    if (session->is_closing)
        return;
    if (size > sizeof session->received - session->received_size) {
        log_line(LOG_LEVEL_ERROR, "%s sent on while it was paused", session->peer);
        connection_abort(session->connection);
        return;
    }
    memcpy(session->received + session->received_size, bytes, size);
    session->received_size += size;
    parse(session);
}

void session_resume(struct session *session)
{
    if (!session->is_closing && !is_blocked(session))
        parse(session);
}

void session_tick(struct session *session, uint64_t now_ns)
{
    const struct options *options = session->server->options;
    uint64_t patience = (uint64_t)options->message_seconds * 1000000000ull;
    if (session->is_closing)
        return;
    if (!session->has_chosen && now_ns - session->opened_ns > patience) {
        log_line(LOG_LEVEL_INFO, "%s is disconnected: no CHOOSE in time", session->peer);
        session_close(session, STATUS_IO, "no CHOOSE came in time");
    } else if (session->partial_ns && now_ns - session->partial_ns > patience) {
        log_line(LOG_LEVEL_INFO, "%s is disconnected: half a message", session->peer);
        session_close(session, STATUS_IO, "a message stayed half sent for too long");
    }
}
