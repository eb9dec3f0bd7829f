//! How do viewers get the stream? A thread publishes the cycles of the feed to subscribers; without subscribers it costs nothing.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context as _, Result, ensure};
use foxglove::websocket::{ChannelView, Client, ServerListener};
use foxglove::{WebSocketServer, WebSocketServerHandle};
use localize::{Field, Stamp};

use super::config::StreamConfig;
use pipeline::feed::{Feed, RecvError, Subscription};
use pipeline::log::Header;
use pipeline::log::publisher::CyclePublisher;
use pipeline::log::schema::{ABOUT_TOPIC, Context, CustomChannel, PROJECT_NAME, Topics, wire};

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
    handle: Option<WebSocketServerHandle>,
    stop_requested: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl StreamServer {
    /// Offers the cycles of a feed to viewers.
    pub(crate) fn start(
        feed: &Feed,
        preamble: StreamPreamble<'_>,
        config: &StreamConfig,
    ) -> Result<Self> {
        let StreamPreamble { header, field } = preamble;
        let quality = config.jpeg_quality;
        ensure!(
            (1..=100).contains(&quality),
            "[stream] invalid jpeg_quality: {quality} (expected 1 to 100)"
        );
        ensure!(
            config.backlog > 0,
            "[stream] invalid backlog: 0 (expected at least 1)"
        );
        let context = Context::new();
        let messages = CyclePublisher::new(Topics::new(&context)?, config.images, quality);
        let about = CustomChannel::new(&context, ABOUT_TOPIC)?;
        let new_subscriber = Arc::new(AtomicBool::new(false));
        let handle = WebSocketServer::new()
            .name(PROJECT_NAME)
            .bind(config.bind.clone(), config.port)
            .message_backlog_size(config.backlog)
            .listener(Arc::new(SubscribeListener(new_subscriber.clone())))
            .context(&context)
            .start_blocking()
            .with_context(|| {
                format!("[stream] cannot listen on {}:{}", config.bind, config.port)
            })?;
        let stop_requested = Arc::new(AtomicBool::new(false));
        let mut worker = StreamWorker {
            cycles: feed.subscribe(MAX_PENDING_CYCLES),
            messages,
            about,
            header_message: header_message(header, config),
            field: field.clone(),
            new_subscriber,
            stop_requested: stop_requested.clone(),
            _context: context,
        };
        let thread = std::thread::Builder::new()
            .name("stream".to_owned())
            .spawn(move || worker.run())?;
        Ok(StreamServer {
            handle: Some(handle),
            stop_requested,
            thread: Some(thread),
        })
    }

    /// The port on which it listens.
    #[cfg(test)]
    pub(crate) fn port(&self) -> u16 {
        self.handle.as_ref().map_or(0, WebSocketServerHandle::port)
    }
}

impl Drop for StreamServer {
    fn drop(&mut self) {
        self.stop_requested.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic was reported when it happened.
            let _ = thread.join();
        }
        if let Some(handle) = self.handle.take() {
            handle.stop().detach_all();
        }
    }
}

/// Notices new subscriptions.
struct SubscribeListener(Arc<AtomicBool>);

impl ServerListener for SubscribeListener {
    fn on_subscribe(&self, _client: Client, _channel: ChannelView) {
        self.0.store(true, Ordering::Release);
    }
}

/// State of the publishing thread.
struct StreamWorker {
    cycles: Subscription,
    messages: CyclePublisher,
    about: CustomChannel<wire::About>,
    header_message: wire::About,
    field: Field,
    new_subscriber: Arc<AtomicBool>,
    stop_requested: Arc<AtomicBool>,
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
            if self.new_subscriber.swap(false, Ordering::Acquire) {
                self.about.log_at(&self.header_message, stamp);
                self.messages.publish_field(&self.field, stamp);
            }
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

fn header_message(header: &Header, config: &StreamConfig) -> wire::About {
    let header = Header {
        images: config.images,
        ..header.clone()
    };
    header.to_message()
}
