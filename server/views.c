#include "server.h"

#include <stdlib.h>

/* ---- views -------------------------------------------------------------------------------------------- */

bool view_check_size(const struct server *server, uint32_t width, uint32_t height, struct error *error)
{
    if (width < 1 || height < 1 || width > VIEW_MAX_SIZE || height > VIEW_MAX_SIZE)
        return error_set(error, STATUS_INVALID, "a view of %ux%u: width and height must be 1 to %u", width,
                         height, VIEW_MAX_SIZE);
    if ((uint64_t)width * height > server->max_pixels)
        return error_set(error, STATUS_LIMIT, "a view of %ux%u has %llu pixels, the server allows %u", width,
                         height, (unsigned long long)width * height, server->max_pixels);
    return true;
}

static void add_to_ring(struct server *server, struct view_entry *view)
{
    if (server->views) {
        view->next = server->views;
        view->previous = server->views->previous;
        view->previous->next = view->next->previous = view;
    } else {
        server->views = view->next = view->previous = view;
    }
}

static void drop_jobs(struct view_entry *view)
{
    while (view->jobs) {
        struct job *job = view->jobs;
        view->jobs = job->next;
        job_destroy(&job);
    }
    view->jobs_end = &view->jobs;
}

static void free_view(struct server *server, struct view_entry *view)
{
    if (server->views == view)
        server->views = view->next == view ? NULL : view->next;
    view->previous->next = view->next;
    view->next->previous = view->previous;
    if (view->owner)
        view->owner->view_count--;
    drop_jobs(view);
    free(view);
}

static void append(struct view_entry *view, struct job *job)
{
    job->entry = view;
    job->view = view->id;
    job->target = &view->render;
    *view->jobs_end = job;
    view->jobs_end = &job->next;
}

void view_queue(struct view_entry *view, struct job *job)
{
    struct session *session = view->owner;
    job->session = session->id;
    job->reply = job->kind == JOB_RENDER ? 0 : reply_reserve(session, job->request);
    session->job_count++;
    append(view, job);
}

bool view_open(struct session *session, uint32_t width, uint32_t height, uint32_t request,
               struct error *error)
{
    struct server *server = session->server;
    if (!view_check_size(server, width, height, error))
        return false;
    if (session->view_count >= server->options->max_views)
        return error_set(error, STATUS_LIMIT, "the server allows %u views per connection",
                         server->options->max_views);
    struct view_entry *view = calloc(1, sizeof *view);
    struct job *job = job_create(JOB_VIEW_CREATE, 0);
    if (!view || !job || server->last_view_id == UINT32_MAX) {
        bool is_worn_out = view && job;
        free(view);
        job_destroy(&job);
        return is_worn_out ? error_set(error, STATUS_LIMIT, "every view id was used: restart the server")
                           : error_set(error, STATUS_MEMORY, "out of memory for a view");
    }
    view->jobs_end = &view->jobs;
    view->id = ++server->last_view_id;
    view->owner = session;
    session->view_count++;
    add_to_ring(server, view);
    job->request = request;
    job->size.width = width;
    job->size.height = height;
    view_queue(view, job);
    return true;
}

static struct view_entry *find(const struct server *server, uint32_t id)
{
    struct view_entry *view = server->views;
    do {
        if (view && view->id == id && view->is_created && !view->is_ending && view->owner)
            return view;
        view = view ? view->next : NULL;
    } while (view && view != server->views);
    return NULL;
}

struct view_entry *view_find_own(struct session *session, uint32_t id, struct error *error)
{
    struct view_entry *view = find(session->server, id);
    if (view && view->owner == session)
        return view;
    error_set(error, STATUS_NOT_FOUND, "view %u is not a view of this connection", id);
    return NULL;
}

struct view_entry *view_find_visible(struct session *session, uint32_t id, struct error *error)
{
    struct view_entry *view = find(session->server, id);
    bool may_share = session->features & PROTOCOL_FEATURE_SHARE;
    if (view && (view->owner == session || (view->is_shared && may_share)))
        return view;
    error_set(error, STATUS_NOT_FOUND, "view %u is neither a view of this connection nor shared with it", id);
    return NULL;
}

/* Ends the subscriptions of everyone but the owner. */
static void dismiss_watchers(struct view_entry *view, const char *text)
{
    struct subscription *next;
    for (struct subscription *subscription = view->subscriptions; subscription; subscription = next) {
        next = subscription->next_of_view;
        struct session *session = subscription->session;
        if (session == view->owner)
            continue;
        subscription_end(subscription);
        session_send_notice(session, PROTOCOL_NOTICE_VIEW_GONE, view->id, STATUS_NOT_FOUND, text);
    }
}

void view_set_shared(struct view_entry *view, bool is_shared)
{
    view->is_shared = is_shared;
    if (!is_shared)
        dismiss_watchers(view, "the view is no longer shared");
}

void view_end(struct view_entry *view, uint32_t request)
{
    struct session *owner = view->owner;
    struct job *job = job_create(JOB_VIEW_DESTROY, 0);
    if (!job) {
        connection_abort(owner->connection);
        return;
    }
    job->request = request;
    view_queue(view, job);
    view->is_ending = true;
    dismiss_watchers(view, "the view was destroyed");
    while (view->subscriptions)
        subscription_end(view->subscriptions);
}

/* The owner is gone: nobody waits for the jobs. */
static void abandon(struct server *server, struct view_entry *view)
{
    bool has_end = false;
    for (struct job *job = view->jobs; job; job = job->next)
        has_end |= job->kind == JOB_VIEW_DESTROY;
    /* When it is ending and the end is not waiting, the render thread has it. */
    bool is_end_at_work = view->is_ending && !has_end;
    dismiss_watchers(view, "the connection that owned the view is gone");
    view->owner = NULL;
    drop_jobs(view);
    if (is_end_at_work)
        return;
    view->is_ending = true;
    if (!view->is_created && !view->at_work) {
        free_view(server, view);
        return;
    }
    struct job *job = job_create(JOB_VIEW_DESTROY, 0);
    if (job)
        append(view, job);
    else
        log_line(LOG_LEVEL_ERROR, "view %u stays: out of memory", view->id);
}

void views_forget_session(struct session *session)
{
    while (session->subscriptions)
        subscription_end(session->subscriptions);
    struct server *server = session->server;
    struct view_entry *view = server->views;
    while (session->view_count && view) {
        struct view_entry *next = view->next;
        if (view->owner == session) {
            session->view_count--;
            abandon(server, view);
            /* `next` stays valid: only `view` can have been freed, and the ring shrinks to nothing with the
             * last. */
        }
        view = server->views ? next : NULL;
    }
}

void views_cancel(struct server *server, const struct error *reason)
{
    struct view_entry *view = server->views;
    if (!view)
        return;
    do {
        for (struct job *job = view->jobs; job; job = job->next) {
            struct session *session = session_find(server, job->session);
            if (session && job->reply)
                reply_fill(session, job->reply, 0, reason);
            else if (session)
                session_send_error(session, job->request, reason);
        }
        drop_jobs(view);
        view = view->next;
    } while (view != server->views);
}

void views_destroy(struct server *server)
{
    while (server->views)
        free_view(server, server->views);
}

/* ---- subscriptions ------------------------------------------------------------------------------------ */

struct subscription *subscription_find(struct session *session, uint32_t view)
{
    struct subscription *subscription = session->subscriptions;
    while (subscription && subscription->view->id != view)
        subscription = subscription->next_of_session;
    return subscription;
}

bool subscription_start(struct session *session, struct view_entry *view, uint32_t request,
                        const struct frame_request *wanted, uint32_t credit, struct error *error)
{
    struct subscription *subscription = calloc(1, sizeof *subscription);
    if (!subscription)
        return error_set(error, STATUS_MEMORY, "out of memory for a subscription");
    struct subscription *former = subscription_find(session, view->id);
    if (former)
        subscription_end(former);
    *subscription = (struct subscription){.session = session,
                                          .view = view,
                                          .request = request,
                                          .wanted = *wanted,
                                          .credit = credit,
                                          .next_of_view = view->subscriptions,
                                          .next_of_session = session->subscriptions};
    view->subscriptions = subscription;
    session->subscriptions = subscription;
    return true;
}

void subscription_end(struct subscription *subscription)
{
    struct subscription **link = &subscription->view->subscriptions;
    while (*link != subscription)
        link = &(*link)->next_of_view;
    *link = subscription->next_of_view;
    link = &subscription->session->subscriptions;
    while (*link != subscription)
        link = &(*link)->next_of_session;
    *link = subscription->next_of_session;
    for (struct output_item *item = subscription->session->output.first; item; item = item->next)
        if (item->subscription == subscription)
            item->subscription = NULL;
    frame_release(&subscription->waiting);
    free(subscription);
}

void subscription_pump(struct subscription *subscription)
{
    struct session *session = subscription->session;
    if (!subscription->waiting || subscription->is_sending || !subscription->credit ||
        session_is_full(session))
        return;
    subscription->credit--;
    subscription->is_sending = true;
    output_frame(session, subscription->waiting, subscription->request, subscription->dropped, subscription);
    subscription->dropped = 0;
    frame_release(&subscription->waiting);
}

static void offer(struct subscription *subscription, struct frame *frame)
{
    if (!subscription->credit) {
        subscription->dropped++;
        return;
    }
    if (subscription->waiting)
        subscription->dropped++;
    frame_release(&subscription->waiting);
    subscription->waiting = frame_reference(frame);
    subscription->is_stale = false;
    subscription_pump(subscription);
}

static bool wants_frame(const struct subscription *subscription)
{
    return subscription->credit && !session_is_full(subscription->session) &&
           (!subscription->waiting || subscription->is_stale);
}

/* A view renders by itself only while its owner is subscribed: other watchers must not change what the
 * owner's RENDERs give. */
static bool is_live_wanted(const struct view_entry *view)
{
    bool is_live = false, is_wanted = false;
    for (const struct subscription *subscription = view->subscriptions; subscription;
         subscription = subscription->next_of_view) {
        is_live |= subscription->session == view->owner;
        is_wanted |= wants_frame(subscription);
    }
    return view->is_created && !view->is_ending && is_live && is_wanted;
}

/* ---- who renders next --------------------------------------------------------------------------------- */

static bool is_equal(const struct frame_request *a, const struct frame_request *b)
{
    return a->channels == b->channels && a->format == b->format && a->encoding == b->encoding;
}

static struct job_output *find_output(struct job *job, const struct frame_request *request)
{
    for (uint32_t i = 0; i < job->output_count; i++)
        if (is_equal(&job->outputs[i].request, request))
            return &job->outputs[i];
    return NULL;
}

/* Adds what the subscriptions want to a JOB_RENDER: each kind of output is made once, however many take it.
 */
static void add_outputs(struct view_entry *view, struct job *job)
{
    uint32_t count = 0;
    for (const struct subscription *subscription = view->subscriptions; subscription;
         subscription = subscription->next_of_view)
        count++;
    if (!count)
        return;
    struct job_output *outputs = realloc(job->outputs, (job->output_count + count) * sizeof *outputs);
    if (!outputs)
        return; /* the subscriptions miss this frame */
    job->outputs = outputs;
    for (const struct subscription *subscription = view->subscriptions; subscription;
         subscription = subscription->next_of_view)
        if (subscription->credit && !find_output(job, &subscription->wanted))
            outputs[job->output_count++] = (struct job_output){.request = subscription->wanted};
}

/* Everything that waits, up to the first frame; without one, a live frame if that is wanted. NULL: no work.
 */
static struct job *make_batch(struct server *server, struct view_entry *view)
{
    struct job *batch = NULL, **end = &batch;
    uint32_t count = 0;
    bool has_frame = false;
    while (view->jobs && !has_frame && count < RENDER_BATCH_SIZE) {
        struct job *job = view->jobs;
        has_frame = job->kind == JOB_RENDER;
        if (has_frame && session_is_full(view->owner))
            break;
        view->jobs = job->next;
        if (!view->jobs)
            view->jobs_end = &view->jobs;
        if (has_frame)
            add_outputs(view, job);
        *end = job;
        end = &job->next;
        count++;
    }
    if (!has_frame && !view->jobs && is_live_wanted(view)) {
        struct job *job = job_create(JOB_RENDER, 0);
        if (job) {
            add_outputs(view, job);
            job->entry = view;
            job->view = view->id;
            job->target = &view->render;
            *end = job;
            end = &job->next;
            count++;
        }
    }
    *end = NULL;
    view->at_work = count;
    server->jobs_at_work = count;
    return batch;
}

void views_schedule(struct server *server)
{
    if (server->jobs_at_work || server->is_draining || !server->views || !server->render)
        return;
    struct view_entry *first = server->views, *view = first;
    do {
        struct job *batch = make_batch(server, view);
        if (batch) {
            server->views = view->next;
            render_thread_submit(server->render, batch);
            return;
        }
        view = view->next;
    } while (view != first);
}

/* ---- what came of it ---------------------------------------------------------------------------------- */

static void end_live(struct view_entry *view, const struct error *error)
{
    while (view->subscriptions) {
        struct subscription *subscription = view->subscriptions;
        struct session *session = subscription->session;
        subscription_end(subscription);
        session_send_notice(session, PROTOCOL_NOTICE_LIVE_ENDED, view->id, error->status, error->message);
    }
}

static void finish_render(struct view_entry *view, struct session *session, struct job *job)
{
    bool is_live = job->session == 0;
    if (!job->is_ok) {
        if (session)
            session_send_error(session, job->request, &job->error);
        if (is_live)
            end_live(view, &job->error);
        return;
    }
    if (session)
        output_frame(session, job->outputs[0].frame, job->request, 0, NULL);
    struct subscription *next;
    for (struct subscription *subscription = view->subscriptions; subscription; subscription = next) {
        next = subscription->next_of_view;
        struct job_output *output = find_output(job, &subscription->wanted);
        if (output)
            offer(subscription, output->frame);
        else if (!subscription->credit)
            subscription->dropped++;
    }
}

static void finish_update(struct view_entry *view, struct session *session, const struct job *job)
{
    if (session)
        reply_fill(session, job->reply, job->kind == JOB_VIEW_CREATE ? view->id : 0,
                   job->is_ok ? NULL : &job->error);
    if (job->is_ok)
        for (struct subscription *subscription = view->subscriptions; subscription;
             subscription = subscription->next_of_view)
            subscription->is_stale = true;
}

static void finish(struct server *server, struct job *job)
{
    struct view_entry *view = job->entry;
    struct session *session = job->session ? session_find(server, job->session) : NULL;
    server->jobs_at_work--;
    view->at_work--;
    server->is_device_lost |= job->is_device_lost;
    if (session)
        session->job_count--;
    if (job->kind == JOB_RENDER)
        finish_render(view, session, job);
    else
        finish_update(view, session, job);
    bool is_gone = job->kind == JOB_VIEW_DESTROY || (job->kind == JOB_VIEW_CREATE && !job->is_ok);
    if (job->kind == JOB_VIEW_CREATE && job->is_ok)
        view->is_created = true;
    if (is_gone)
        free_view(server, view);
    if (session)
        session_resume(session);
}

void views_collect(struct server *server)
{
    struct job *jobs = render_thread_collect(server->render);
    while (jobs) {
        struct job *job = jobs;
        jobs = job->next;
        finish(server, job);
        job_destroy(&job);
    }
    views_schedule(server);
}
