//! A simulation of the view's own: a thread that plays a scenario at its pace and takes orders between two samples.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Result;
use localize::Pose;
use localize::frame::{At, FieldFrame};
use localize::omni::Twist;
use sim::film::FilmConfig;
use sim::scenario::FaultKind;

use super::Shown;
use super::live::Inbox;
use pipeline::cycle::{Pipeline, PipelineConfig};
use pipeline::setup::Setup;
use pipeline::simulation::Simulation;

/// A pause lasts at most so long before the thread looks for orders again.
const NAP: Duration = Duration::from_millis(20);

/// So many orders wait at most: some seconds of a hand that drives, one order a drawn frame.
const ORDERS: usize = 256;
/// Behind its pace by more than this, it does not try to catch up, seconds.
const LATE: f64 = 0.1;

/// What the view may ask of its simulation.
#[derive(Debug, Clone)]
pub(crate) enum Order {
    /// Stands still, or goes on.
    Pause(bool),
    /// Goes on until the next cycle.
    Step,
    /// Simulated seconds a second; infinite: as fast as it goes.
    Pace(f64),
    /// Puts the robot elsewhere.
    Kidnap(Pose),
    /// Puts another robot elsewhere, by its number.
    MoveOther(usize, Pose),
    /// Hits the robot, N s on the field.
    Push([f32; 2]),
    /// Puts the ball somewhere, with a velocity in m/s.
    Ball(At<FieldFrame>, [f32; 2]),
    /// The light's level; none: the scenario's.
    Light(Option<f32>),
    /// Something black in the view: middle and width, degrees.
    Occlude(Option<(f32, f32)>),
    /// The camera's settings.
    Film(FilmConfig),
    /// Drives by hand; none: the scenario's way.
    Drive(Option<Twist>),
    /// A sensor fails, or works again.
    Fault(FaultKind, usize, bool),
    /// Other settings of vision and localisation; the pose is kept.
    Configure(Box<PipelineConfig>),
    /// From the start, with this seed.
    Restart(u64),
}

/// What the simulation tells besides its cycles.
#[derive(Debug, Clone)]
pub(crate) struct Status {
    /// Simulated seconds.
    pub(crate) time: f64,
    /// Where chance started from.
    pub(crate) seed: u64,
    /// How long the scenario lasts, seconds.
    pub(crate) duration: f64,
    /// It stands still.
    pub(crate) paused: bool,
    /// Simulated seconds a second that were asked for.
    pub(crate) pace: f64,
    /// The camera's settings.
    pub(crate) film: FilmConfig,
    /// Why the last order was not followed.
    pub(crate) refused: Option<String>,
}

/// The view's end of it; dropping it ends the thread.
pub(crate) struct SimWorker {
    /// The scenario's file.
    pub(crate) scenario: PathBuf,
    orders: SyncSender<Order>,
    status: Arc<Mutex<Status>>,
}

impl SimWorker {
    /// Reads the scenario, and starts its thread.
    pub(crate) fn start(
        scenario: &Path,
        seed: Option<u64>,
        config: PipelineConfig,
        inbox: Inbox,
    ) -> Result<(Self, Setup)> {
        let simulation = Simulation::load(scenario, seed, None)?;
        let setup = simulation.setup()?;
        let spine = Pipeline::new(&setup, &config)?;
        let status = Arc::new(Mutex::new(Status {
            time: 0.0,
            seed: simulation.sim().scenario().seed,
            duration: simulation.duration(),
            paused: false,
            pace: 1.0,
            film: *simulation.sim().image_sensor(),
            refused: None,
        }));
        let (orders, received) = sync_channel(ORDERS);
        let mut running = Running {
            scenario: scenario.to_owned(),
            setup: simulation.setup()?,
            simulation,
            spine,
            config,
            inbox,
            status: status.clone(),
            paused: false,
            pace: 1.0,
            started: (Instant::now(), 0.0),
            steps: 0,
        };
        std::thread::Builder::new()
            .name("sim".to_owned())
            .spawn(move || running.run(&received))?;
        let worker = SimWorker {
            scenario: scenario.to_owned(),
            orders,
            status,
        };
        Ok((worker, setup))
    }

    /// Asks for something; it is done between two samples.
    pub(crate) fn order(&self, order: Order) {
        // The thread ends with this sender alone; what a stuck one cannot take is not waited for.
        let _ = self.orders.try_send(order);
    }

    /// How it stands.
    pub(crate) fn status(&self) -> Status {
        self.status
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }
}

/// The thread's end.
struct Running {
    scenario: PathBuf,
    setup: Setup,
    simulation: Simulation,
    spine: Pipeline,
    config: PipelineConfig,
    inbox: Inbox,
    status: Arc<Mutex<Status>>,
    paused: bool,
    pace: f64,
    /// When, and at which simulated second, the pace began to count.
    started: (Instant, f64),
    /// Cycles that are still to be run though it is paused.
    steps: u32,
}

impl Running {
    fn run(&mut self, orders: &Receiver<Order>) {
        loop {
            let still = self.paused && self.steps == 0;
            if still {
                match orders.recv_timeout(NAP) {
                    Ok(order) => self.follow(order),
                    Err(std::sync::mpsc::RecvTimeoutError::Timeout) => {}
                    Err(std::sync::mpsc::RecvTimeoutError::Disconnected) => return,
                }
            }
            loop {
                match orders.try_recv() {
                    Ok(order) => self.follow(order),
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Disconnected) => return,
                }
            }
            if self.paused && self.steps == 0 {
                continue;
            }
            match self.simulation.next() {
                Some(sample) => self.take(sample),
                None => self.pause(true),
            }
        }
    }

    fn take(&mut self, sample: pipeline::sample::Sample) {
        let Some(cycle) = self.spine.process_sample(sample) else {
            return;
        };
        if let Some(command) = cycle.camera_command() {
            self.simulation.command_camera(command);
        }
        let time = cycle.stamp.seconds();
        self.steps = self.steps.saturating_sub(1);
        self.wait(time);
        self.inbox.put(Shown {
            cycle: Arc::new(cycle),
            particles: self.spine.particles().to_vec(),
        });
        self.tell(|status| status.time = time);
    }

    /// Until the wall clock has come to a simulated second, by the pace.
    fn wait(&mut self, time: f64) {
        let due = (time - self.started.1) / self.pace;
        let late = self.started.0.elapsed().as_secs_f64() - due;
        if late < 0.0 {
            std::thread::sleep(Duration::from_secs_f64((-late).min(1.0)));
        } else if late > LATE {
            self.started = (Instant::now(), time);
        }
    }

    fn pause(&mut self, paused: bool) {
        self.paused = paused;
        self.steps = 0;
        self.started = (Instant::now(), self.simulation.sim().time());
        self.tell(|status| status.paused = paused);
    }

    fn follow(&mut self, order: Order) {
        self.tell(|status| status.refused = None);
        match order {
            Order::Pause(paused) => return self.pause(paused),
            Order::Step => {
                self.pause(true);
                self.steps = 1;
                return;
            }
            Order::Pace(pace) => {
                self.pace = pace.max(0.01);
                self.started = (Instant::now(), self.simulation.sim().time());
                return self.tell(|status| status.pace = pace);
            }
            Order::Configure(config) => return self.configure(*config),
            Order::Restart(seed) => return self.restart(seed),
            _ => {}
        }
        let sim = self.simulation.sim_mut();
        match order {
            Order::Kidnap(pose) => sim.kidnap(pose),
            Order::MoveOther(number, pose) => sim.place_other(number, pose),
            Order::Push(impulse) => sim.apply_impulse(impulse),
            Order::Ball(at, velocity) => sim.place_ball(at, velocity),
            Order::Light(level) => sim.set_light_level(level),
            Order::Occlude(sector) => sim.set_occlusion(sector),
            Order::Drive(twist) => sim.set_command(twist),
            Order::Fault(kind, wheel, fails) => sim.set_fault(kind, wheel, fails),
            Order::Film(film) => {
                sim.set_image_sensor(film);
                self.tell(|status| status.film = film);
            }
            Order::Pause(_)
            | Order::Step
            | Order::Pace(_)
            | Order::Configure(_)
            | Order::Restart(_) => {}
        }
    }

    fn configure(&mut self, config: PipelineConfig) {
        match Pipeline::new(&self.setup, &config) {
            Ok(mut spine) => {
                spine.warm_start_from(&self.spine);
                self.spine = spine;
                self.config = config;
            }
            Err(error) => self.tell(|status| status.refused = Some(format!("{error:#}"))),
        }
    }

    fn restart(&mut self, seed: u64) {
        let fresh = Simulation::load(&self.scenario, Some(seed), None)
            .and_then(|simulation| Ok((simulation, Pipeline::new(&self.setup, &self.config)?)));
        match fresh {
            Ok((simulation, spine)) => {
                let film = *simulation.sim().image_sensor();
                (self.simulation, self.spine) = (simulation, spine);
                self.pause(false);
                self.tell(|status| (status.seed, status.film, status.time) = (seed, film, 0.0));
            }
            Err(error) => self.tell(|status| status.refused = Some(format!("{error:#}"))),
        }
    }

    fn tell(&self, change: impl FnOnce(&mut Status)) {
        change(&mut self.status.lock().unwrap_or_else(PoisonError::into_inner));
    }
}
