//! The base over pseudo terminals: whatever happens on the line, the wheels turn only for a fresh command.

mod bench_top;

use std::f32::consts::TAU;
use std::time::Duration;

use bench_top::{Socket, event, until};
use hw::base::{Drive, Kick};
use hw::config::{BaseDevice, Bus};
use hw::wire::board::{Encoders, Message, Packet, Switches, WheelCommand};
use hw::wire::vesc::{Request, Values};
use hw::wire::{CanFrame, Stream, board, slcan, vesc_can};
use hw::{Base, Event, HwError, Inbox, State};
use localize::omni::Twist;
use localize::robot::BaseConfig;

fn device(bus: Bus, port: String) -> BaseDevice {
    BaseDevice {
        bus,
        port,
        baud: 115_200,
        can_bit_rate: 500_000,
        nodes: match bus {
            Bus::Board => Vec::new(),
            _ => vec![11, 12, 13],
        },
        uart_node: 11,
        reversed: vec![false, false, true],
        send_twist: false,
        rate_hz: 200.0,
        command_age_max: 0.1,
        brake_time: 0.05,
        stall: 0.3,
        imu: true,
        compass: true,
        north_deg: 0.0,
    }
}

/// A base board on the bench.
struct Board {
    socket: Socket,
    commands: Stream<Packet>,
    sequence: u16,
}

impl Board {
    fn new(socket: Socket) -> Self {
        Board {
            socket,
            commands: board::stream(),
            sequence: 0,
        }
    }

    fn say(&mut self, message: impl Into<Message>) {
        self.sequence += 1;
        let packet = Packet {
            sequence: self.sequence,
            message: message.into(),
        };
        self.socket.send(&packet.encode());
    }

    fn say_counts(&mut self, count: u32) {
        let time_us = (hw::now().0 / 1000) as u32;
        let count = [count, count, 0u32.wrapping_sub(count), 0];
        self.say(Encoders { time_us, count });
    }

    fn told(&mut self) -> Vec<Message> {
        self.commands.extend(&self.socket.received());
        self.commands
            .by_ref()
            .map(|packet| packet.message)
            .collect()
    }

    /// The next wheel commands.
    fn wheels(&mut self) -> Vec<WheelCommand> {
        let told = self.told().into_iter();
        told.filter_map(|message| match message {
            Message::WheelCommand(command) => Some(command),
            _ => None,
        })
        .collect()
    }
}

fn soon() -> localize::Stamp {
    hw::now() + 0.08
}

#[test]
fn a_board_that_appears_late_is_driven_and_its_counters_become_odometry() {
    let mut socket = Socket::empty();
    let inbox = Inbox::new(1024);
    let base = Base::start(
        &device(Bus::Board, socket.name()),
        &BaseConfig::default(),
        &inbox,
    )
    .expect("a base");
    let said = event(&inbox, "the word that it is missing", |event| match event {
        Event::Health(health) => health.reason,
        _ => None,
    });
    assert!(said.contains("is missing"), "{said}");
    socket.plug();
    let mut board = Board::new(socket);
    let turn = Twist {
        theta: 1.0,
        ..Twist::default()
    };
    let command = until("a wheel command", || {
        base.helm()
            .drive(Drive::Twist(turn), soon())
            .expect("driven");
        board
            .wheels()
            .into_iter()
            .find(|command| command.speed_crad[0] != 0)
    });
    // 0.2 m at 1 rad/s over wheels of 0.05 m: 4 rad/s; the third motor turns the other way.
    assert_eq!(command.speed_crad, [400, 400, -400, 0]);
    assert_eq!(command.wheels, 3);
    assert!((1..=80).contains(&command.valid_ms), "{}", command.valid_ms);
    let mut count = u32::MAX - 20;
    let (odometry, slip) = until("odometry", || {
        count = count.wrapping_add(40);
        board.say_counts(count);
        inbox
            .take(Duration::from_millis(2))
            .and_then(|event| match event {
                Event::Odometry(odometry) => Some((odometry, odometry.slip)),
                _ => None,
            })
    });
    let wanted = 40.0 / 4096.0 * TAU * 0.05 / 0.2;
    let steps = odometry.dtheta / wanted;
    assert!(
        steps >= 0.999 && (steps - steps.round()).abs() < 1e-3,
        "{odometry:?}"
    );
    assert!(odometry.dx.abs() + odometry.dy.abs() < 1e-6 && slip == 0.0);
    until("the word that it runs", || {
        board.say_counts(count);
        (base.health().state == State::Running).then_some(())
    });
}

#[test]
fn without_fresh_commands_the_wheels_stop_and_stay_stopped() {
    let socket = Socket::plugged();
    let inbox = Inbox::new(1024);
    let base = Base::start(
        &device(Bus::Board, socket.name()),
        &BaseConfig::default(),
        &inbox,
    )
    .expect("a base");
    let mut board = Board::new(socket);
    let mut commands = Vec::new();
    // What is commanded before the line is there is forgotten.
    until("the line", || {
        board.say_counts(0);
        commands.extend(board.wheels());
        (!commands.is_empty()).then_some(())
    });
    let forward = Twist {
        x: 1.0,
        ..Twist::default()
    };
    let began = hw::now();
    base.helm()
        .drive(Drive::Twist(forward), began + 10.0)
        .expect("driven");
    until("many zeros after the speeds", || {
        board.say_counts(0);
        commands.extend(board.wheels());
        let last = commands
            .iter()
            .rev()
            .take_while(|command| command.speed_crad == [0; 4]);
        let driven = commands.iter().any(|command| command.speed_crad != [0; 4]);
        (driven && last.count() > 30).then_some(())
    });
    let first_stop = commands
        .iter()
        .skip_while(|command| command.speed_crad == [0; 4]);
    let after: Vec<_> = first_stop
        .skip_while(|command| command.speed_crad != [0; 4])
        .collect();
    assert!(
        after.iter().all(|command| command.speed_crad == [0; 4]),
        "{after:?}"
    );
    let longest = commands.iter().map(|command| command.valid_ms).max();
    assert!(
        longest <= Some(100),
        "{longest:?}: whatever deadline was asked for"
    );
}

#[test]
fn an_unplugged_board_comes_back_standing_still() {
    let socket = Socket::plugged();
    let inbox = Inbox::new(1024);
    let base = Base::start(
        &device(Bus::Board, socket.name()),
        &BaseConfig::default(),
        &inbox,
    )
    .expect("a base");
    let mut board = Board::new(socket);
    for round in 0..3 {
        until("a running base that drives", || {
            board.say_counts(round);
            base.helm()
                .drive(Drive::Wheels([9.0; 4]), soon())
                .expect("driven");
            let moves = board
                .wheels()
                .iter()
                .any(|command| command.speed_crad[0] == 900);
            (moves && base.health().state == State::Running).then_some(())
        });
        board.socket.unplug();
        until("the word that it is gone", || {
            std::thread::sleep(Duration::from_millis(2));
            (base.health().state == State::Absent).then_some(())
        });
        // By now the last command is stale.
        std::thread::sleep(Duration::from_millis(120));
        board.socket.plug();
        board.commands.clear();
        let first = until("the first command", || board.wheels().first().copied());
        assert_eq!(first.speed_crad, [0; 4]);
    }
    assert_eq!(base.health().reopened, 3);
}

#[test]
fn garbage_and_silence_are_told_apart_and_recovered_from() {
    let socket = Socket::plugged();
    let inbox = Inbox::new(1024);
    let base = Base::start(
        &device(Bus::Board, socket.name()),
        &BaseConfig::default(),
        &inbox,
    )
    .expect("a base");
    let mut board = Board::new(socket);
    let reach = |wanted: State, board: &mut Board, say: &mut dyn FnMut(&mut Board)| {
        until(&format!("{wanted:?}"), || {
            say(board);
            board.told();
            (base.health().state == wanted).then_some(())
        });
    };
    reach(State::Running, &mut board, &mut |board| board.say_counts(1));
    reach(State::Garbage, &mut board, &mut |board| {
        board.socket.send(&[0x55, 0xAA, 0, 1, 2, 3, 0]);
    });
    reach(State::Running, &mut board, &mut |board| board.say_counts(1));
    reach(State::Stalled, &mut board, &mut |_| {});
    reach(State::Running, &mut board, &mut |board| board.say_counts(1));
    // A board that speaks, but not of its wheels, is no running base.
    let switches = Switches {
        bumpers: 4,
        ..Switches::default()
    };
    reach(State::Stalled, &mut board, &mut |board| board.say(switches));
    let health = base.health();
    assert!(health.reason.expect("a reason").contains("encoder"));
    assert!(health.garbage_bytes > 0 && health.faults >= 3);
}

#[test]
fn commands_that_are_no_numbers_stop_the_wheels_and_a_kick_happens_once() {
    let socket = Socket::plugged();
    let inbox = Inbox::new(1024);
    let base = Base::start(
        &device(Bus::Board, socket.name()),
        &BaseConfig::default(),
        &inbox,
    )
    .expect("a base");
    let mut board = Board::new(socket);
    until("speed", || {
        base.helm()
            .drive(Drive::Wheels([2.0, 2.0, 2.0, 0.0]), soon())
            .expect("driven");
        board
            .wheels()
            .into_iter()
            .find(|command| command.speed_crad[0] == 200)
    });
    let refused = base
        .helm()
        .drive(Drive::Wheels([1.0, f32::NAN, 0.0, 0.0]), soon());
    assert!(matches!(refused, Err(HwError::Unfit { .. })));
    until("a stop", || {
        board
            .wheels()
            .into_iter()
            .find(|command| command.speed_crad == [0; 4])
    });
    let kick = Kick {
        speed: 7.5,
        lofted: true,
    };
    base.helm().kick(kick, soon()).expect("kicked");
    let mut kicks = Vec::new();
    let mut after = 0;
    until("a kick and what follows", || {
        for message in board.told() {
            match message {
                Message::KickCommand(kick) => kicks.push(kick),
                _ => after += usize::from(!kicks.is_empty()),
            }
        }
        (after > 30).then_some(())
    });
    assert_eq!(kicks.len(), 1);
    assert_eq!((kicks[0].speed_mm, kicks[0].lofted), (7500, 1));
}

#[test]
fn halt_and_drop_leave_the_wheels_told_to_stop() {
    let socket = Socket::plugged();
    let inbox = Inbox::new(1024);
    let base = Base::start(
        &device(Bus::Board, socket.name()),
        &BaseConfig::default(),
        &inbox,
    )
    .expect("a base");
    let mut board = Board::new(socket);
    let drive = || {
        base.helm()
            .drive(Drive::Wheels([2.0; 4]), soon())
            .expect("driven")
    };
    until("speed", || {
        drive();
        board
            .wheels()
            .into_iter()
            .find(|command| command.speed_crad[0] == 200)
    });
    drive();
    assert!(base.helm().halt(Duration::from_secs(5)));
    until("a stop", || {
        board
            .wheels()
            .last()
            .filter(|command| command.speed_crad == [0; 4])
            .copied()
    });
    drive();
    drop(base);
    let last = until("the last word", || board.wheels().last().copied());
    assert_eq!(last.speed_crad, [0; 4]);
    let missing = Socket::empty();
    let base = Base::start(
        &device(Bus::Board, missing.name()),
        &BaseConfig::default(),
        &inbox,
    )
    .expect("a base");
    assert!(
        !base.helm().halt(Duration::from_millis(20)),
        "nobody was told"
    );
}

/// What a wheel is told: a speed or a current.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Told {
    Erpm(i32),
    CurrentMa(i32),
}

/// Runs the three VESCs at `answer` until the wheels were driven and let go again, and returns what each was told.
fn drive_vescs(
    bus: Bus,
    socket: &Socket,
    mut answer: impl FnMut(&Socket, &[u8], u32) -> Vec<(u8, Told)>,
) -> Vec<(u8, Told)> {
    let inbox = Inbox::new(1024);
    let base =
        Base::start(&device(bus, socket.name()), &BaseConfig::default(), &inbox).expect("a base");
    let refused = base.helm().kick(
        Kick {
            speed: 1.0,
            lofted: false,
        },
        soon(),
    );
    assert!(matches!(refused, Err(HwError::Unfit { .. })));
    let turn = Twist {
        theta: 1.0,
        ..Twist::default()
    };
    let (mut log, mut ticks) = (Vec::new(), 0u32);
    let odometry = until("odometry", || {
        base.helm()
            .drive(Drive::Twist(turn), soon())
            .expect("driven");
        ticks = ticks.wrapping_add(3);
        log.extend(answer(socket, &socket.received(), ticks));
        let event = inbox.take(Duration::from_millis(1));
        event.and_then(|event| match event {
            Event::Odometry(odometry) if odometry.dtheta > 0.0 => Some(odometry),
            _ => None,
        })
    });
    assert!(odometry.dtheta < 0.5);
    until("let go", || {
        log.extend(answer(socket, &socket.received(), ticks));
        let released = log.iter().rev().take(3);
        (log.len() > 30
            && released
                .clone()
                .all(|(_, told)| *told == Told::CurrentMa(0)))
        .then_some(())
    });
    let power = event(&inbox, "power", |event| match event {
        Event::Power(power) => Some(power),
        _ => None,
    });
    assert!((power.battery - 24.6).abs() < 1e-4);
    log
}

/// Driven at 4 rad/s with 4096 steps a turn (the third the other way), then braked, then let go.
fn assert_driven_braked_let_go(log: &[(u8, Told)]) {
    let erpm = (4.0 / TAU * 60.0 * 4096.0 / 6.0) as i32;
    for (node, wanted) in [(11, erpm), (12, erpm), (13, -erpm)] {
        let mut told: Vec<_> = log
            .iter()
            .filter(|(to, _)| *to == node)
            .map(|(_, t)| *t)
            .collect();
        told.dedup();
        // Before the first command the motors are free.
        if told.first() == Some(&Told::CurrentMa(0)) {
            told.remove(0);
        }
        // A line begins with wheels that stand.
        let driven = Told::Erpm(wanted);
        assert_eq!(
            told,
            [Told::Erpm(0), driven, Told::Erpm(0), Told::CurrentMa(0)],
            "node {node}"
        );
    }
}

#[test]
fn vescs_on_a_uart_are_driven_braked_and_let_go() {
    let socket = Socket::plugged();
    let mut pending = Vec::new();
    let log = drive_vescs(Bus::VescUart, &socket, |socket, bytes, ticks| {
        pending.extend_from_slice(bytes);
        let mut told = Vec::new();
        // Packets are of known length: 02, length, payload, three bytes.
        while pending.len() > 2 && pending.len() >= usize::from(pending[1]) + 5 {
            let packet: Vec<u8> = pending.drain(..usize::from(pending[1]) + 5).collect();
            let (node, request) = Request::decode(&packet).expect("a request");
            let node = node.unwrap_or(11);
            match request {
                Request::SetRpm(erpm) => told.push((node, Told::Erpm(erpm))),
                Request::SetCurrentMa(current) => told.push((node, Told::CurrentMa(current))),
                Request::GetValues => {
                    let sign = if node == 13 { -1 } else { 1 };
                    let values = Values {
                        node,
                        tachometer: sign * ticks as i32,
                        voltage_dv: 246,
                        ..Values::default()
                    };
                    socket.send(&values.encode());
                }
            }
        }
        told
    });
    assert_driven_braked_let_go(&log);
}

#[test]
fn vescs_behind_an_slcan_adapter_are_driven_braked_and_let_go() {
    let socket = Socket::plugged();
    let mut lines = slcan::stream();
    let mut setup = Vec::new();
    let log = drive_vescs(Bus::VescSlcan, &socket, |socket, bytes, ticks| {
        if setup.len() < 64 {
            setup.extend_from_slice(bytes);
        }
        lines.extend(bytes);
        let told: Vec<_> = lines
            .by_ref()
            .filter_map(|line| match line {
                slcan::Line::Frame(frame) => vesc_can::Order::decode(&frame),
                _ => None,
            })
            .map(|(node, order)| match order {
                vesc_can::Order::SetRpm(erpm) => (node, Told::Erpm(erpm)),
                vesc_can::Order::SetCurrentMa(current) => (node, Told::CurrentMa(current)),
            })
            .collect();
        let mut answer = Vec::new();
        for node in [11, 12, 13, 99] {
            let sign = if node == 13 { -1 } else { 1 };
            let status = vesc_can::Status::Position {
                tachometer: sign * ticks as i32,
                voltage_dv: 246,
            };
            slcan::encode(&status.encode(node), &mut answer);
        }
        let standard = CanFrame::new(0x123, false, &[1]).expect("a frame");
        slcan::encode(&standard, &mut answer);
        socket.send(&answer);
        told
    });
    assert_driven_braked_let_go(&log);
    assert!(setup.starts_with(b"\rC\rS6\rO\r"), "{setup:?}");
}

#[test]
fn a_can_interface_that_is_not_there_is_named() {
    let message = hw::CanSocket::open("can77")
        .expect_err("no such interface")
        .to_string();
    assert!(message.contains("can77"), "{message}");
}

#[test]
fn wheels_and_controllers_must_be_as_many() {
    let mut wrong = device(Bus::VescCan, "can0".to_owned());
    wrong.nodes.pop();
    let refused = Base::start(&wrong, &BaseConfig::default(), &Inbox::new(8));
    let message = refused.expect_err("refused").to_string();
    assert!(
        message.contains("base.nodes") && message.contains("3 are wanted"),
        "{message}"
    );
}
