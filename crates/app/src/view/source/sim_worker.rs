//! A simulation of the view's own: a thread that plays a scenario at its pace and takes orders between two samples.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Result;
use localize::Pose;
use localize::frames::{At, FieldFrame};
use localize::omni::Twist;
use sim::image_sensor::FilmConfig;
use sim::scenario::FaultKind;

use super::DecodedCycle;
use super::live::CycleInbox;
use pipeline::setup::Setup;
use pipeline::simulation::Simulation;
use pipeline::{Pipeline, PipelineConfig};

/// A pause lasts at most so long before the thread looks for orders again.
const PAUSED_POLL_INTERVAL: Duration = Duration::from_millis(20);

/// So many orders wait at most: some seconds of a hand that drives, one order a drawn frame.
const REQUEST_CAPACITY: usize = 256;
/// Behind its pace by more than this, it does not try to catch up, seconds.
const MAX_LAG: f64 = 0.1;

/// What the view may ask of its simulation.
#[derive(Debug, Clone)]
pub(crate) enum SourceRequest {
    /// Stands still, or goes on.
    Pause(bool),
    /// Goes on until the next cycle.
    Step,
    /// Simulated seconds a second; infinite: as fast as it goes.
    SetSpeed(f64),
    /// Puts the robot elsewhere.
    Kidnap(Pose),
    /// Puts another robot elsewhere, by its number.
    PlaceOther(usize, Pose),
    /// Hits the robot, N s on the field.
    ApplyImpulse([f32; 2]),
    /// Puts the ball somewhere, with a velocity in m/s.
    PlaceBall(At<FieldFrame>, [f32; 2]),
    /// The light's level; none: the scenario's.
    SetLightLevel(Option<f32>),
    /// Something black in the view: middle and width, degrees.
    SetOcclusion(Option<(f32, f32)>),
    /// The camera's settings.
    SetImageSensor(FilmConfig),
    /// Drives by hand; none: the scenario's way.
    Drive(Option<Twist>),
    /// A sensor fails, or works again.
    SetFault(FaultKind, usize, bool),
    /// Other settings of vision and localisation; the pose is kept.
    Configure(Box<PipelineConfig>),
    /// From the start, with this seed.
    Restart(u64),
}

/// What the simulation tells besides its cycles.
#[derive(Debug, Clone)]
pub(crate) struct SimStatus {
    /// Simulated seconds.
    pub(crate) time: f64,
    /// Where chance started from.
    pub(crate) seed: u64,
    /// How long the scenario lasts, seconds.
    pub(crate) duration: f64,
    /// It stands still.
    pub(crate) paused: bool,
    /// Simulated seconds a second that were asked for.
    pub(crate) speed: f64,
    /// The camera's settings.
    pub(crate) image_sensor: FilmConfig,
    /// Why the last order was not followed.
    pub(crate) error: Option<String>,
}

/// The view's end of it; dropping it ends the thread.
pub(crate) struct SimWorker {
    /// The scenario's file.
    pub(crate) scenario: PathBuf,
    requests: SyncSender<SourceRequest>,
    status: Arc<Mutex<SimStatus>>,
}

impl SimWorker {
    /// Reads the scenario, and starts its thread.
    pub(crate) fn start(
        scenario: &Path,
        seed: Option<u64>,
        config: PipelineConfig,
        inbox: CycleInbox,
    ) -> Result<(Self, Setup)> {
        let simulation = Simulation::load(scenario, seed, None)?;
        let setup = simulation.setup()?;
        let spine = Pipeline::new(&setup, &config)?;
        let status = Arc::new(Mutex::new(SimStatus {
            time: 0.0,
            seed: simulation.sim().scenario().seed,
            duration: simulation.duration(),
            paused: false,
            speed: 1.0,
            image_sensor: *simulation.sim().image_sensor(),
            error: None,
        }));
        let (orders, received) = sync_channel(REQUEST_CAPACITY);
        let mut running = SimThread {
            scenario: scenario.to_owned(),
            setup: simulation.setup()?,
            simulation,
            spine,
            config,
            inbox,
            status: status.clone(),
            paused: false,
            speed: 1.0,
            speed_reference: (Instant::now(), 0.0),
            pending_cycles: 0,
        };
        std::thread::Builder::new()
            .name("sim".to_owned())
            .spawn(move || running.run(&received))?;
        let worker = SimWorker {
            scenario: scenario.to_owned(),
            requests: orders,
            status,
        };
        Ok((worker, setup))
    }

    /// Asks for something; it is done between two samples.
    pub(crate) fn request(&self, order: SourceRequest) {
        // The thread ends with this sender alone; what a stuck one cannot take is not waited for.
        let _ = self.requests.try_send(order);
    }

    /// How it stands.
    pub(crate) fn status(&self) -> SimStatus {
        self.status
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }
}

/// The thread's end.
struct SimThread {
    scenario: PathBuf,
    setup: Setup,
    simulation: Simulation,
    spine: Pipeline,
    config: PipelineConfig,
    inbox: CycleInbox,
    status: Arc<Mutex<SimStatus>>,
    paused: bool,
    speed: f64,
    /// When, and at which simulated second, the pace began to count.
    speed_reference: (Instant, f64),
    /// Cycles that are still to be run though it is paused.
    pending_cycles: u32,
}

impl SimThread {
    fn run(&mut self, orders: &Receiver<SourceRequest>) {
        loop {
            let still = self.paused && self.pending_cycles == 0;
            if still {
                match orders.recv_timeout(PAUSED_POLL_INTERVAL) {
                    Ok(order) => self.handle_request(order),
                    Err(std::sync::mpsc::RecvTimeoutError::Timeout) => {}
                    Err(std::sync::mpsc::RecvTimeoutError::Disconnected) => return,
                }
            }
            loop {
                match orders.try_recv() {
                    Ok(order) => self.handle_request(order),
                    Err(TryRecvError::Empty) => break,
                    Err(TryRecvError::Disconnected) => return,
                }
            }
            if self.paused && self.pending_cycles == 0 {
                continue;
            }
            match self.simulation.next() {
                Some(sample) => self.process_sample(sample),
                None => self.set_paused(true),
            }
        }
    }

    fn process_sample(&mut self, sample: pipeline::sample::Sample) {
        let Some(cycle) = self.spine.process_sample(sample) else {
            return;
        };
        if let Some(command) = cycle.camera_command() {
            self.simulation.command_camera(command);
        }
        let time = cycle.stamp.seconds();
        self.pending_cycles = self.pending_cycles.saturating_sub(1);
        self.wait_until(time);
        self.inbox.push(DecodedCycle {
            cycle: Arc::new(cycle),
            particles: self.spine.particles().to_vec(),
        });
        self.update_status(|status| status.time = time);
    }

    /// Until the wall clock has come to a simulated second, by the pace.
    fn wait_until(&mut self, time: f64) {
        let due = (time - self.speed_reference.1) / self.speed;
        let late = self.speed_reference.0.elapsed().as_secs_f64() - due;
        if late < 0.0 {
            std::thread::sleep(Duration::from_secs_f64((-late).min(1.0)));
        } else if late > MAX_LAG {
            self.speed_reference = (Instant::now(), time);
        }
    }

    fn set_paused(&mut self, paused: bool) {
        self.paused = paused;
        self.pending_cycles = 0;
        self.speed_reference = (Instant::now(), self.simulation.sim().time());
        self.update_status(|status| status.paused = paused);
    }

    fn handle_request(&mut self, order: SourceRequest) {
        self.update_status(|status| status.error = None);
        match order {
            SourceRequest::Pause(paused) => return self.set_paused(paused),
            SourceRequest::Step => {
                self.set_paused(true);
                self.pending_cycles = 1;
                return;
            }
            SourceRequest::SetSpeed(pace) => {
                self.speed = pace.max(0.01);
                self.speed_reference = (Instant::now(), self.simulation.sim().time());
                return self.update_status(|status| status.speed = pace);
            }
            SourceRequest::Configure(config) => return self.configure(*config),
            SourceRequest::Restart(seed) => return self.restart(seed),
            _ => {}
        }
        let sim = self.simulation.sim_mut();
        match order {
            SourceRequest::Kidnap(pose) => sim.kidnap(pose),
            SourceRequest::PlaceOther(number, pose) => sim.place_other(number, pose),
            SourceRequest::ApplyImpulse(impulse) => sim.apply_impulse(impulse),
            SourceRequest::PlaceBall(at, velocity) => sim.place_ball(at, velocity),
            SourceRequest::SetLightLevel(level) => sim.set_light_level(level),
            SourceRequest::SetOcclusion(sector) => sim.set_occlusion(sector),
            SourceRequest::Drive(twist) => sim.set_command(twist),
            SourceRequest::SetFault(kind, wheel, fails) => sim.set_fault(kind, wheel, fails),
            SourceRequest::SetImageSensor(film) => {
                sim.set_image_sensor(film);
                self.update_status(|status| status.image_sensor = film);
            }
            SourceRequest::Pause(_)
            | SourceRequest::Step
            | SourceRequest::SetSpeed(_)
            | SourceRequest::Configure(_)
            | SourceRequest::Restart(_) => {}
        }
    }

    fn configure(&mut self, config: PipelineConfig) {
        match Pipeline::new(&self.setup, &config) {
            Ok(mut spine) => {
                spine.warm_start_from(&self.spine);
                self.spine = spine;
                self.config = config;
            }
            Err(error) => self.update_status(|status| status.error = Some(format!("{error:#}"))),
        }
    }

    fn restart(&mut self, seed: u64) {
        let fresh = Simulation::load(&self.scenario, Some(seed), None)
            .and_then(|simulation| Ok((simulation, Pipeline::new(&self.setup, &self.config)?)));
        match fresh {
            Ok((simulation, spine)) => {
                let film = *simulation.sim().image_sensor();
                (self.simulation, self.spine) = (simulation, spine);
                self.set_paused(false);
                self.update_status(|status| {
                    (status.seed, status.image_sensor, status.time) = (seed, film, 0.0)
                });
            }
            Err(error) => self.update_status(|status| status.error = Some(format!("{error:#}"))),
        }
    }

    fn update_status(&self, change: impl FnOnce(&mut SimStatus)) {
        change(&mut self.status.lock().unwrap_or_else(PoisonError::into_inner));
    }
}
