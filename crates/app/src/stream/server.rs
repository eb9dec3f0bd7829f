//! How do viewers get the stream? A thread publishes the cycles of the feed to subscribers; without subscribers it costs nothing.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context as _, Result};
use foxglove::websocket::{ChannelView, Client, ServerListener};
use foxglove::{SinkId, WebSocketServer, WebSocketServerHandle};
use localize::{Field, Stamp};

use super::config::StreamConfig;
use super::guard::{Guard, GuardedServer};
use super::parameters::{SettingsHandler, all_parameters};
use crate::run::tuning::TuningHandle;
use pipeline::feed::{Feed, RecvError, Subscription};
use pipeline::log::Header;
use pipeline::log::publisher::CyclePublisher;
use pipeline::log::schema::{
    ABOUT_TOPIC, CALIBRATION_TOPIC, Context, CustomChannel, FIELD_LINES_TOPIC, FIELD_SCENE_TOPIC,
    PROJECT_NAME, Topics, wire,
};

/// Capacity of the queue of cycles to publish; the newest two keep their images.
const MAX_PENDING_CYCLES: usize = 8;
/// A new viewer gets the header within this time, even without new cycles.
const HEADER_DEADLINE: Duration = Duration::from_millis(100);

/// What viewers get when they subscribe: the start of a log of the run.
#[derive(Clone, Copy)]
pub(crate) struct StreamPreamble<'a> {
    /// Configuration of the run.
    pub header: &'a Header,
    /// The field, for its drawing.
    pub field: &'a Field,
}

/// A live stream. Dropping it ends it.
pub(crate) struct StreamServer {
    guard: Guard,
    server: Arc<Mutex<FoxgloveServer>>,
    stop_requested: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl StreamServer {
    /// Offers the cycles of a feed to viewers.
    pub(crate) fn start(
        feed: &Feed,
        preamble: StreamPreamble<'_>,
        tuning: Option<TuningHandle>,
        config: &StreamConfig,
    ) -> Result<Self> {
        config.check()?;
        let StreamPreamble { header, field } = preamble;
        let context = Context::new();
        let topics = Topics::new(&context)?;
        let messages = CyclePublisher::new(topics, config.images, config.jpeg_quality, header);
        let about = CustomChannel::new(&context, ABOUT_TOPIC)?;
        let new_viewers = Arc::new(Mutex::new(Vec::new()));
        let server = FoxgloveServer::start(&context, config.backlog, &new_viewers, tuning.clone())
            .context("[stream] cannot start the server")?;
        let server = Arc::new(Mutex::new(server));
        let guard = Guard::start(
            (&config.bind, config.port),
            config.limits(),
            SharedServer(server.clone()),
        )
        .with_context(|| format!("[stream] cannot listen on {}:{}", config.bind, config.port))?;
        let stop_requested = Arc::new(AtomicBool::new(false));
        let mut worker = StreamWorker {
            cycles: feed.subscribe(MAX_PENDING_CYCLES),
            messages,
            about,
            header_message: header_message(header, config),
            field: field.clone(),
            new_viewers,
            stop_requested: stop_requested.clone(),
            tuning: tuning.map(|desk| (desk, 0)),
            server: server.clone(),
            _context: context,
        };
        let thread = std::thread::Builder::new()
            .name("stream".to_owned())
            .spawn(move || worker.run())?;
        Ok(StreamServer {
            guard,
            server,
            stop_requested,
            thread: Some(thread),
        })
    }

    /// Messages for the operator since the last call.
    pub(crate) fn take_notices(&self) -> Vec<String> {
        self.guard.take_notices()
    }

    /// The port on which it listens.
    #[cfg(test)]
    pub(crate) fn port(&self) -> u16 {
        self.guard.address().port()
    }
}

impl Drop for StreamServer {
    fn drop(&mut self) {
        self.stop_requested.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic was reported when it happened.
            let _ = thread.join();
        }
        lock(&self.server).stop();
    }
}

/// A viewer that has just subscribed to a topic.
struct NewViewer {
    sink: Option<SinkId>,
    topic: NewTopic,
}

/// What a new viewer of a topic needs first.
#[derive(PartialEq, Eq)]
enum NewTopic {
    About,
    Scenery,
}

/// New viewers that have not been served yet. More than this many are a flood, and wait for their next subscription.
const MAX_NEW_VIEWERS: usize = 64;

/// Notices new subscriptions.
struct SubscribeListener(Arc<Mutex<Vec<NewViewer>>>);

impl ServerListener for SubscribeListener {
    fn on_subscribe(&self, client: Client, channel: ChannelView) {
        let topic = match channel.topic() {
            ABOUT_TOPIC => NewTopic::About,
            FIELD_LINES_TOPIC | FIELD_SCENE_TOPIC | CALIBRATION_TOPIC => NewTopic::Scenery,
            _ => return,
        };
        let sink = client.sink_id();
        let mut viewers = lock(&self.0);
        let is_known = viewers
            .iter()
            .any(|viewer| viewer.sink == sink && viewer.topic == topic);
        if !is_known && viewers.len() < MAX_NEW_VIEWERS {
            viewers.push(NewViewer { sink, topic });
        }
    }
}

/// Foxglove's server on a loopback port, and what is needed to start it again.
struct FoxgloveServer {
    context: Arc<Context>,
    backlog: usize,
    new_viewers: Arc<Mutex<Vec<NewViewer>>>,
    tuning: Option<TuningHandle>,
    handle: Option<WebSocketServerHandle>,
}

impl FoxgloveServer {
    fn start(
        context: &Arc<Context>,
        backlog: usize,
        new_viewers: &Arc<Mutex<Vec<NewViewer>>>,
        tuning: Option<TuningHandle>,
    ) -> Result<Self> {
        let mut server = FoxgloveServer {
            context: context.clone(),
            backlog,
            new_viewers: new_viewers.clone(),
            tuning,
            handle: None,
        };
        server.restart()?;
        Ok(server)
    }

    fn restart(&mut self) -> Result<()> {
        self.stop();
        let mut server = WebSocketServer::new()
            .name(PROJECT_NAME)
            .bind("127.0.0.1", 0)
            .message_backlog_size(self.backlog)
            .listener(Arc::new(SubscribeListener(self.new_viewers.clone())))
            .context(&self.context);
        if let Some(desk) = &self.tuning {
            server = server.parameter_handler(Arc::new(SettingsHandler(desk.clone())));
        }
        self.handle = Some(server.start_blocking()?);
        Ok(())
    }

    fn stop(&mut self) {
        if let Some(handle) = self.handle.take() {
            handle.stop().detach_all();
        }
    }
}

/// The server as the guard uses it.
struct SharedServer(Arc<Mutex<FoxgloveServer>>);

impl GuardedServer for SharedServer {
    fn address(&self) -> SocketAddr {
        let port = lock(&self.0)
            .handle
            .as_ref()
            .map(WebSocketServerHandle::port);
        SocketAddr::from(([127, 0, 0, 1], port.unwrap_or(0)))
    }

    fn restart(&mut self) -> Result<()> {
        lock(&self.0).restart()
    }
}

// The state is valid even if a thread panicked with the lock.
fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// State of the publishing thread.
struct StreamWorker {
    cycles: Subscription,
    messages: CyclePublisher,
    about: CustomChannel<wire::About>,
    header_message: wire::About,
    field: Field,
    new_viewers: Arc<Mutex<Vec<NewViewer>>>,
    stop_requested: Arc<AtomicBool>,
    /// The settings, and the revision that viewers have.
    tuning: Option<(TuningHandle, u64)>,
    server: Arc<Mutex<FoxgloveServer>>,
    /// Connects channels and viewers; must live as long as the thread.
    _context: Arc<Context>,
}

impl StreamWorker {
    fn run(&mut self) {
        let mut stamp = Stamp(0);
        while !self.stop_requested.load(Ordering::Relaxed) {
            let next = self.cycles.recv_indexed(HEADER_DEADLINE);
            if let Ok(((_, cycle), _)) = &next {
                stamp = cycle.stamp;
            }
            // Only those who have just subscribed: the header has the size of many cycles.
            for NewViewer { sink, topic } in std::mem::take(&mut *lock(&self.new_viewers)) {
                match topic {
                    NewTopic::About => {
                        let time = self.messages.message_time(stamp);
                        self.about.log_to(&self.header_message, time, sink);
                    }
                    NewTopic::Scenery => self.messages.publish_scenery(&self.field, stamp, sink),
                }
            }
            self.publish_settings();
            match next {
                Ok(((index, cycle), dropped)) => {
                    if let Err(error) = self.messages.publish_cycle(index, &cycle) {
                        self.messages.log_error(&format!("{error:#}"), stamp);
                    }
                    self.messages.log_dropped("the stream", dropped, stamp);
                }
                Err(RecvError::Timeout) => {}
                Err(RecvError::Closed) => return,
            }
        }
    }
}

impl StreamWorker {
    /// Sends the settings to the viewers that follow them, if they have changed.
    fn publish_settings(&mut self) {
        let Some((desk, known)) = &mut self.tuning else {
            return;
        };
        let revision = desk.revision();
        if std::mem::replace(known, revision) != revision
            && let Some(handle) = &lock(&self.server).handle
        {
            handle.publish_parameter_values(all_parameters(desk));
        }
    }
}

fn header_message(header: &Header, config: &StreamConfig) -> wire::About {
    let header = Header {
        images: config.images,
        ..header.clone()
    };
    header.to_message()
}
