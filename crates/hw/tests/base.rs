//! The base over pseudo terminals: whatever happens on the line, the wheels turn only for a fresh command.

mod pseudo_terminal;

use std::f32::consts::TAU;
use std::time::Duration;

use hw::base::{Kick, MotionCommand};
use hw::config::{BaseDeviceConfig, Bus};
use hw::wire::board::{Encoders, Message, Packet, Switches, WheelCommand};
use hw::wire::vesc::{Request, Values};
use hw::wire::{CanFrame, StreamDecoder, board, slcan, vesc_can};
use hw::{BaseDriver, DeviceEvent, EventQueue, HealthState, HwError};
use localize::omni::Twist;
use localize::robot::BaseConfig;
use pseudo_terminal::{PseudoSerialPort, wait_for_event, wait_until};

fn device(bus: Bus, port: String) -> BaseDeviceConfig {
    BaseDeviceConfig {
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
struct FakeBoard {
    socket: PseudoSerialPort,
    commands: StreamDecoder<Packet>,
    sequence: u16,
}

impl FakeBoard {
    fn new(socket: PseudoSerialPort) -> Self {
        FakeBoard {
            socket,
            commands: board::decoder(),
            sequence: 0,
        }
    }

    fn send(&mut self, message: impl Into<Message>) {
        self.sequence += 1;
        let packet = Packet {
            sequence: self.sequence,
            message: message.into(),
        };
        self.socket.send(&packet.encode());
    }

    fn send_counts(&mut self, count: u32) {
        let time_us = (hw::now().0 / 1000) as u32;
        let count = [count, count, 0u32.wrapping_sub(count), 0];
        self.send(Encoders { time_us, count });
    }

    fn received_messages(&mut self) -> Vec<Message> {
        self.commands.extend(&self.socket.read());
        self.commands
            .by_ref()
            .map(|packet| packet.message)
            .collect()
    }

    /// The next wheel commands.
    fn received_wheel_commands(&mut self) -> Vec<WheelCommand> {
        let told = self.received_messages().into_iter();
        told.filter_map(|message| match message {
            Message::WheelCommand(command) => Some(command),
            _ => None,
        })
        .collect()
    }
}

fn short_deadline() -> localize::Stamp {
    hw::now() + 0.08
}

#[test]
fn board_connected_after_start_is_driven_and_yields_odometry() {
    let mut socket = PseudoSerialPort::disconnected();
    let inbox = EventQueue::new(1024);
    let base = BaseDriver::start(
        &device(Bus::Board, socket.path_string()),
        &BaseConfig::default(),
        &inbox,
    )
    .expect("a base");
    let said = wait_for_event(&inbox, "the word that it is missing", |event| match event {
        DeviceEvent::Health(health) => health.reason,
        _ => None,
    });
    assert!(said.contains("is missing"), "{said}");
    socket.connect();
    let mut board = FakeBoard::new(socket);
    let turn = Twist {
        theta: 1.0,
        ..Twist::default()
    };
    let command = wait_until("a wheel command", || {
        base.handle()
            .drive(MotionCommand::Twist(turn), short_deadline())
            .expect("driven");
        board
            .received_wheel_commands()
            .into_iter()
            .find(|command| command.speed_crad[0] != 0)
    });
    // 0.2 m at 1 rad/s over wheels of 0.05 m: 4 rad/s; the third motor turns the other way.
    assert_eq!(command.speed_crad, [400, 400, -400, 0]);
    assert_eq!(command.wheels, 3);
    assert!((1..=80).contains(&command.valid_ms), "{}", command.valid_ms);
    let mut count = u32::MAX - 20;
    let (odometry, slip) = wait_until("odometry", || {
        count = count.wrapping_add(40);
        board.send_counts(count);
        inbox
            .pop_timeout(Duration::from_millis(2))
            .and_then(|event| match event {
                DeviceEvent::Odometry(odometry) => Some((odometry, odometry.slip)),
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
    wait_until("the word that it runs", || {
        board.send_counts(count);
        (base.health().state == HealthState::Running).then_some(())
    });
}

#[test]
fn wheels_stop_without_fresh_commands() {
    let socket = PseudoSerialPort::connected();
    let inbox = EventQueue::new(1024);
    let base = BaseDriver::start(
        &device(Bus::Board, socket.path_string()),
        &BaseConfig::default(),
        &inbox,
    )
    .expect("a base");
    let mut board = FakeBoard::new(socket);
    let mut commands = Vec::new();
    // What is commanded before the line is there is forgotten.
    wait_until("the line", || {
        board.send_counts(0);
        commands.extend(board.received_wheel_commands());
        (!commands.is_empty()).then_some(())
    });
    let forward = Twist {
        x: 1.0,
        ..Twist::default()
    };
    let began = hw::now();
    base.handle()
        .drive(MotionCommand::Twist(forward), began + 10.0)
        .expect("driven");
    wait_until("many zeros after the speeds", || {
        board.send_counts(0);
        commands.extend(board.received_wheel_commands());
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
fn first_command_after_reconnect_is_zero_speed() {
    let socket = PseudoSerialPort::connected();
    let inbox = EventQueue::new(1024);
    let base = BaseDriver::start(
        &device(Bus::Board, socket.path_string()),
        &BaseConfig::default(),
        &inbox,
    )
    .expect("a base");
    let mut board = FakeBoard::new(socket);
    for round in 0..3 {
        wait_until("a running base that drives", || {
            board.send_counts(round);
            base.handle()
                .drive(MotionCommand::WheelSpeeds([9.0; 4]), short_deadline())
                .expect("driven");
            let moves = board
                .received_wheel_commands()
                .iter()
                .any(|command| command.speed_crad[0] == 900);
            (moves && base.health().state == HealthState::Running).then_some(())
        });
        board.socket.disconnect();
        wait_until("the word that it is gone", || {
            std::thread::sleep(Duration::from_millis(2));
            (base.health().state == HealthState::Absent).then_some(())
        });
        // By now the last command is stale.
        std::thread::sleep(Duration::from_millis(120));
        board.socket.connect();
        board.commands.reset();
        let first = wait_until("the first command", || {
            board.received_wheel_commands().first().copied()
        });
        assert_eq!(first.speed_crad, [0; 4]);
    }
    assert_eq!(base.health().reopened, 3);
}

#[test]
fn garbage_and_stall_are_distinguished_and_recovered_from() {
    let socket = PseudoSerialPort::connected();
    let inbox = EventQueue::new(1024);
    let base = BaseDriver::start(
        &device(Bus::Board, socket.path_string()),
        &BaseConfig::default(),
        &inbox,
    )
    .expect("a base");
    let mut board = FakeBoard::new(socket);
    let reach =
        |wanted: HealthState, board: &mut FakeBoard, say: &mut dyn FnMut(&mut FakeBoard)| {
            wait_until(&format!("{wanted:?}"), || {
                say(board);
                board.received_messages();
                (base.health().state == wanted).then_some(())
            });
        };
    reach(HealthState::Running, &mut board, &mut |board| {
        board.send_counts(1)
    });
    reach(HealthState::Garbage, &mut board, &mut |board| {
        board.socket.send(&[0x55, 0xAA, 0, 1, 2, 3, 0]);
    });
    reach(HealthState::Running, &mut board, &mut |board| {
        board.send_counts(1)
    });
    reach(HealthState::Stalled, &mut board, &mut |_| {});
    reach(HealthState::Running, &mut board, &mut |board| {
        board.send_counts(1)
    });
    // A board that speaks, but not of its wheels, is no running base.
    let switches = Switches {
        bumpers: 4,
        ..Switches::default()
    };
    reach(HealthState::Stalled, &mut board, &mut |board| {
        board.send(switches)
    });
    let health = base.health();
    assert!(health.reason.expect("a reason").contains("encoder"));
    assert!(health.garbage_bytes > 0 && health.faults >= 3);
}

#[test]
fn non_finite_command_stops_the_wheels_and_kick_is_sent_once() {
    let socket = PseudoSerialPort::connected();
    let inbox = EventQueue::new(1024);
    let base = BaseDriver::start(
        &device(Bus::Board, socket.path_string()),
        &BaseConfig::default(),
        &inbox,
    )
    .expect("a base");
    let mut board = FakeBoard::new(socket);
    wait_until("speed", || {
        base.handle()
            .drive(
                MotionCommand::WheelSpeeds([2.0, 2.0, 2.0, 0.0]),
                short_deadline(),
            )
            .expect("driven");
        board
            .received_wheel_commands()
            .into_iter()
            .find(|command| command.speed_crad[0] == 200)
    });
    let refused = base.handle().drive(
        MotionCommand::WheelSpeeds([1.0, f32::NAN, 0.0, 0.0]),
        short_deadline(),
    );
    assert!(matches!(refused, Err(HwError::Unsupported { .. })));
    wait_until("a stop", || {
        board
            .received_wheel_commands()
            .into_iter()
            .find(|command| command.speed_crad == [0; 4])
    });
    let kick = Kick {
        speed: 7.5,
        lofted: true,
    };
    base.handle().kick(kick, short_deadline()).expect("kicked");
    let mut kicks = Vec::new();
    let mut after = 0;
    wait_until("a kick and what follows", || {
        for message in board.received_messages() {
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
fn halt_and_drop_send_a_stop_command() {
    let socket = PseudoSerialPort::connected();
    let inbox = EventQueue::new(1024);
    let base = BaseDriver::start(
        &device(Bus::Board, socket.path_string()),
        &BaseConfig::default(),
        &inbox,
    )
    .expect("a base");
    let mut board = FakeBoard::new(socket);
    let drive = || {
        base.handle()
            .drive(MotionCommand::WheelSpeeds([2.0; 4]), short_deadline())
            .expect("driven")
    };
    wait_until("speed", || {
        drive();
        board
            .received_wheel_commands()
            .into_iter()
            .find(|command| command.speed_crad[0] == 200)
    });
    drive();
    assert!(base.handle().halt(Duration::from_secs(5)));
    wait_until("a stop", || {
        board
            .received_wheel_commands()
            .last()
            .filter(|command| command.speed_crad == [0; 4])
            .copied()
    });
    drive();
    drop(base);
    let last = wait_until("the last word", || {
        board.received_wheel_commands().last().copied()
    });
    assert_eq!(last.speed_crad, [0; 4]);
    let missing = PseudoSerialPort::disconnected();
    let base = BaseDriver::start(
        &device(Bus::Board, missing.path_string()),
        &BaseConfig::default(),
        &inbox,
    )
    .expect("a base");
    assert!(
        !base.handle().halt(Duration::from_millis(20)),
        "nobody was told"
    );
}

/// What a wheel is told: a speed or a current.
#[derive(Debug, Clone, Copy, PartialEq)]
enum VescSetpoint {
    Erpm(i32),
    CurrentMa(i32),
}

/// Runs the three VESCs at `answer` until the wheels were driven and let go again, and returns what each was told.
fn run_vesc_drive(
    bus: Bus,
    socket: &PseudoSerialPort,
    mut answer: impl FnMut(&PseudoSerialPort, &[u8], u32) -> Vec<(u8, VescSetpoint)>,
) -> Vec<(u8, VescSetpoint)> {
    let inbox = EventQueue::new(1024);
    let base = BaseDriver::start(
        &device(bus, socket.path_string()),
        &BaseConfig::default(),
        &inbox,
    )
    .expect("a base");
    let refused = base.handle().kick(
        Kick {
            speed: 1.0,
            lofted: false,
        },
        short_deadline(),
    );
    assert!(matches!(refused, Err(HwError::Unsupported { .. })));
    let turn = Twist {
        theta: 1.0,
        ..Twist::default()
    };
    let (mut log, mut ticks) = (Vec::new(), 0u32);
    let odometry = wait_until("odometry", || {
        base.handle()
            .drive(MotionCommand::Twist(turn), short_deadline())
            .expect("driven");
        ticks = ticks.wrapping_add(3);
        log.extend(answer(socket, &socket.read(), ticks));
        let event = inbox.pop_timeout(Duration::from_millis(1));
        event.and_then(|event| match event {
            DeviceEvent::Odometry(odometry) if odometry.dtheta > 0.0 => Some(odometry),
            _ => None,
        })
    });
    assert!(odometry.dtheta < 0.5);
    wait_until("let go", || {
        log.extend(answer(socket, &socket.read(), ticks));
        let released = log.iter().rev().take(3);
        (log.len() > 30
            && released
                .clone()
                .all(|(_, told)| *told == VescSetpoint::CurrentMa(0)))
        .then_some(())
    });
    let power = wait_for_event(&inbox, "power", |event| match event {
        DeviceEvent::Power(power) => Some(power),
        _ => None,
    });
    assert!((power.battery_voltage - 24.6).abs() < 1e-4);
    log
}

/// Driven at 4 rad/s with 4096 steps a turn (the third the other way), then braked, then let go.
fn assert_drive_brake_release(log: &[(u8, VescSetpoint)]) {
    let erpm = (4.0 / TAU * 60.0 * 4096.0 / 6.0) as i32;
    for (node, wanted) in [(11, erpm), (12, erpm), (13, -erpm)] {
        let mut told: Vec<_> = log
            .iter()
            .filter(|(to, _)| *to == node)
            .map(|(_, t)| *t)
            .collect();
        told.dedup();
        // Before the first command the motors are free.
        if told.first() == Some(&VescSetpoint::CurrentMa(0)) {
            told.remove(0);
        }
        // A line begins with wheels that stand.
        let driven = VescSetpoint::Erpm(wanted);
        assert_eq!(
            told,
            [
                VescSetpoint::Erpm(0),
                driven,
                VescSetpoint::Erpm(0),
                VescSetpoint::CurrentMa(0)
            ],
            "node {node}"
        );
    }
}

#[test]
fn vescs_over_uart_drive_brake_and_release() {
    let socket = PseudoSerialPort::connected();
    let mut pending = Vec::new();
    let log = run_vesc_drive(Bus::VescUart, &socket, |socket, bytes, ticks| {
        pending.extend_from_slice(bytes);
        let mut told = Vec::new();
        // Packets are of known length: 02, length, payload, three bytes.
        while pending.len() > 2 && pending.len() >= usize::from(pending[1]) + 5 {
            let packet: Vec<u8> = pending.drain(..usize::from(pending[1]) + 5).collect();
            let (node, request) = Request::decode(&packet).expect("a request");
            let node = node.unwrap_or(11);
            match request {
                Request::SetRpm(erpm) => told.push((node, VescSetpoint::Erpm(erpm))),
                Request::SetCurrentMa(current) => {
                    told.push((node, VescSetpoint::CurrentMa(current)))
                }
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
    assert_drive_brake_release(&log);
}

#[test]
fn vescs_over_slcan_drive_brake_and_release() {
    let socket = PseudoSerialPort::connected();
    let mut lines = slcan::decoder();
    let mut setup = Vec::new();
    let log = run_vesc_drive(Bus::VescSlcan, &socket, |socket, bytes, ticks| {
        if setup.len() < 64 {
            setup.extend_from_slice(bytes);
        }
        lines.extend(bytes);
        let told: Vec<_> = lines
            .by_ref()
            .filter_map(|line| match line {
                slcan::SlcanMessage::Frame(frame) => vesc_can::VescCommand::decode(&frame),
                _ => None,
            })
            .map(|(node, order)| match order {
                vesc_can::VescCommand::SetRpm(erpm) => (node, VescSetpoint::Erpm(erpm)),
                vesc_can::VescCommand::SetCurrentMa(current) => {
                    (node, VescSetpoint::CurrentMa(current))
                }
            })
            .collect();
        let mut answer = Vec::new();
        for node in [11, 12, 13, 99] {
            let sign = if node == 13 { -1 } else { 1 };
            let status = vesc_can::VescStatus::Position {
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
    assert_drive_brake_release(&log);
    assert!(setup.starts_with(b"\rC\rS6\rO\r"), "{setup:?}");
}

#[test]
fn missing_can_interface_is_named_in_the_error() {
    let message = hw::CanSocket::open("can77")
        .expect_err("no such interface")
        .to_string();
    assert!(message.contains("can77"), "{message}");
}

#[test]
fn wheel_and_controller_counts_must_match() {
    let mut wrong = device(Bus::VescCan, "can0".to_owned());
    wrong.nodes.pop();
    let refused = BaseDriver::start(&wrong, &BaseConfig::default(), &EventQueue::new(8));
    let message = refused.expect_err("refused").to_string();
    assert!(
        message.contains("base.nodes") && message.contains("3 are wanted"),
        "{message}"
    );
}
