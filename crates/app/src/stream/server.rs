//! Who is watching? Cycles from the feed become messages for those who subscribed; nobody there costs nothing.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context as _, Result, ensure};
use foxglove::websocket::{ChannelView, Client, ServerListener};
use foxglove::{WebSocketServer, WebSocketServerHandle};
use localize::{Field, Stamp};

use super::StreamConfig;
use pipeline::feed::{Feed, Nothing, Subscription};
use pipeline::log::Header;
use pipeline::log::messages::Messages;
use pipeline::log::schema::{ABOUT, ABOUT_TOPIC, Context, Own, Topics, wire};

/// Cycles that may wait to become messages; the image of the newest two stays.
const CYCLES_WAITING: usize = 8;
/// A viewer is greeted within this time, even by a run that stands still.
const GREETING_WITHIN: Duration = Duration::from_millis(100);

/// A live stream that is being offered; dropping it ends it.
pub struct Server {
    handle: Option<WebSocketServerHandle>,
    ending: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Offers the cycles of a feed to whoever connects.
    ///
    /// `header`: what a log of the run would start with; viewers get it when they subscribe.
    pub fn start(
        feed: &Feed,
        header: &Header,
        field: &Field,
        config: &StreamConfig,
    ) -> Result<Self> {
        let quality = config.jpeg_quality;
        ensure!(
            (1..=100).contains(&quality),
            "[stream] jpeg_quality = {quality}: must be 1 to 100"
        );
        ensure!(
            config.backlog > 0,
            "[stream] backlog = 0: must be at least 1"
        );
        let context = Context::new();
        let messages = Messages::new(Topics::new(&context)?, config.images, quality);
        let about = Own::new(&context, ABOUT_TOPIC)?;
        let newcomer = Arc::new(AtomicBool::new(false));
        let handle = WebSocketServer::new()
            .name(ABOUT)
            .bind(config.bind.clone(), config.port)
            .message_backlog_size(config.backlog)
            .listener(Arc::new(Door(newcomer.clone())))
            .context(&context)
            .start_blocking()
            .with_context(|| {
                format!("[stream] cannot listen on {}:{}", config.bind, config.port)
            })?;
        let ending = Arc::new(AtomicBool::new(false));
        let mut stage = Stage {
            cycles: feed.subscribe(CYCLES_WAITING),
            messages,
            about,
            greeting: greeting(header, config),
            field: field.clone(),
            newcomer,
            ending: ending.clone(),
            _context: context,
        };
        let thread = std::thread::Builder::new()
            .name("stream".to_owned())
            .spawn(move || stage.run())?;
        Ok(Server {
            handle: Some(handle),
            ending,
            thread: Some(thread),
        })
    }

    /// The port on which it listens.
    pub fn port(&self) -> u16 {
        self.handle.as_ref().map_or(0, WebSocketServerHandle::port)
    }

    /// How many are watching.
    pub fn viewers(&self) -> usize {
        self.handle
            .as_ref()
            .map_or(0, WebSocketServerHandle::client_count)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.ending.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // Its panic was told when it happened.
            let _ = thread.join();
        }
        if let Some(handle) = self.handle.take() {
            handle.stop().detach_all();
        }
    }
}

/// Notices who subscribes.
struct Door(Arc<AtomicBool>);

impl ServerListener for Door {
    fn on_subscribe(&self, _client: Client, _channel: ChannelView) {
        self.0.store(true, Ordering::Release);
    }
}

/// The thread's side.
struct Stage {
    cycles: Subscription,
    messages: Messages,
    about: Own<wire::About>,
    greeting: wire::About,
    field: Field,
    newcomer: Arc<AtomicBool>,
    ending: Arc<AtomicBool>,
    /// Joins channels and viewers for as long as it lives.
    _context: Arc<Context>,
}

impl Stage {
    fn run(&mut self) {
        let mut stamp = Stamp(0);
        while !self.ending.load(Ordering::Relaxed) {
            let next = self.cycles.entry(GREETING_WITHIN);
            if let Ok(((_, cycle), _)) = &next {
                stamp = cycle.stamp;
            }
            if self.newcomer.swap(false, Ordering::Acquire) {
                self.about.log_at(&self.greeting, stamp);
                self.messages.field(&self.field, stamp);
            }
            match next {
                Ok(((index, cycle), dropped)) => {
                    if let Err(error) = self.messages.cycle(index, &cycle) {
                        self.messages.tell_fault(&format!("{error:#}"), stamp);
                    }
                    self.messages.tell_dropped("the stream", dropped, stamp);
                }
                Err(Nothing::Yet) => {}
                Err(Nothing::Ever) => return,
            }
        }
    }
}

fn greeting(header: &Header, config: &StreamConfig) -> wire::About {
    let header = Header {
        images: config.images,
        ..header.clone()
    };
    header.to_message()
}
