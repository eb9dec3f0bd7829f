//! The base over pseudo terminals: whatever happens on the bus, the wheels turn only for a valid command.

mod fake_board;
mod faults;
#[path = "../pseudo_terminal/mod.rs"]
mod pseudo_terminal;

use std::f32::consts::TAU;
use std::time::Duration;

use fake_board::{FakeBoard, device, short_deadline};
use hw::base::{Kick, MotionCommand};
use hw::config::Bus;
use hw::wire::board::{Message, Switches, WheelCommand};
use hw::wire::vesc::{Request, RoutedRequest, Values};
use hw::wire::vesc_can::Addressed;
use hw::wire::{CanFrame, slcan, vesc_can};
use hw::{BaseDriver, DeviceEvent, EventQueue, HealthState, HwError};
use localize::omni::Twist;
use localize::robot::BaseConfig;
use pseudo_terminal::{PseudoSerialPort, wait_for_event, wait_until};

#[test]
fn board_connected_after_start_is_driven_and_yields_odometry() {
    let mut port = PseudoSerialPort::disconnected();
    let queue = EventQueue::new(1024);
    let base = BaseDriver::start(
        &device(Bus::Board, port.path_string()),
        &BaseConfig::default(),
        &queue,
    )
    .expect("a base");
    let reason = wait_for_event(&queue, "a health report", |event| match event {
        DeviceEvent::Health(health) => health.reason,
        _ => None,
    });
    assert!(reason.contains("is missing"), "{reason}");
    port.connect();
    let mut board = FakeBoard::new(port);
    let rotation = Twist {
        theta: 1.0,
        ..Twist::default()
    };
    let mut count = u32::MAX - 20;
    let command = wait_until("a wheel command", || {
        board.send_counts(count);
        base.handle()
            .drive(MotionCommand::Twist(rotation), short_deadline())
            .expect("driven");
        board
            .received_wheel_commands()
            .into_iter()
            .find(|command| command.speed_crad[0] != 0)
    });
    // 0.2 m at 1 rad/s over wheels of 0.05 m: 4 rad/s; the third motor is reversed.
    assert_eq!(command.speed_crad, [400, 400, -400, 0]);
    assert_eq!(command.wheels, 3);
    assert!((1..=80).contains(&command.valid_ms), "{}", command.valid_ms);
    let (odometry, slip) = wait_until("odometry", || {
        count = count.wrapping_add(40);
        board.send_counts(count);
        queue
            .pop_timeout(Duration::from_millis(2))
            .and_then(|event| match event {
                DeviceEvent::Odometry(odometry) if odometry.dtheta != 0.0 => {
                    Some((odometry, odometry.slip))
                }
                _ => None,
            })
    });
    let step = 40.0 / 4096.0 * TAU * 0.05 / 0.2;
    let steps = odometry.dtheta / step;
    assert!(
        steps >= 0.999 && (steps - steps.round()).abs() < 1e-3,
        "{odometry:?}"
    );
    assert!(odometry.dx.abs() + odometry.dy.abs() < 1e-6 && slip == 0.0);
    wait_until("the running state", || {
        board.send_counts(count);
        (base.health().state == HealthState::Running).then_some(())
    });
}

#[test]
fn wheels_stop_without_fresh_commands() {
    let port = PseudoSerialPort::connected();
    let queue = EventQueue::new(1024);
    let base = BaseDriver::start(
        &device(Bus::Board, port.path_string()),
        &BaseConfig::default(),
        &queue,
    )
    .expect("a base");
    let mut board = FakeBoard::new(port);
    let mut commands = Vec::new();
    // Commands from before the port is open are discarded.
    wait_until("the first wheel command", || {
        board.send_counts(0);
        commands.extend(board.received_wheel_commands());
        (!commands.is_empty()).then_some(())
    });
    let forward = Twist {
        x: 1.0,
        ..Twist::default()
    };
    let drive = || {
        base.handle()
            .drive(MotionCommand::Twist(forward), hw::now() + 10.0)
            .expect("driven");
        hw::now()
    };
    let is_driven = |commands: &[WheelCommand]| {
        let mut speeds = commands.iter().map(|command| command.speed_crad);
        speeds.any(|speeds| speeds != [0; 4])
    };
    let mut driven_at = drive();
    wait_until("many zero commands after the speeds", || {
        board.send_counts(0);
        // A loaded machine may delay the bus for longer than a command is valid.
        if !is_driven(&commands) && hw::now() - driven_at > 2.0 {
            driven_at = drive();
        }
        commands.extend(board.received_wheel_commands());
        let last = commands
            .iter()
            .rev()
            .take_while(|command| command.speed_crad == [0; 4]);
        (is_driven(&commands) && last.count() > 30).then_some(())
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
        "{longest:?}: validity is limited whatever the deadline"
    );
}

#[test]
fn first_command_after_reconnect_is_zero_speed() {
    let port = PseudoSerialPort::connected();
    let queue = EventQueue::new(1024);
    let base = BaseDriver::start(
        &device(Bus::Board, port.path_string()),
        &BaseConfig::default(),
        &queue,
    )
    .expect("a base");
    let mut board = FakeBoard::new(port);
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
        board.port.disconnect();
        wait_until("the absent state", || {
            std::thread::sleep(Duration::from_millis(2));
            (base.health().state == HealthState::Absent).then_some(())
        });
        // Then the last command has expired.
        std::thread::sleep(Duration::from_millis(120));
        board.port.connect();
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
    let port = PseudoSerialPort::connected();
    let queue = EventQueue::new(1024);
    let base = BaseDriver::start(
        &device(Bus::Board, port.path_string()),
        &BaseConfig::default(),
        &queue,
    )
    .expect("a base");
    let mut board = FakeBoard::new(port);
    let reach =
        |expected: HealthState, board: &mut FakeBoard, send: &mut dyn FnMut(&mut FakeBoard)| {
            wait_until(&format!("{expected:?}"), || {
                send(board);
                board.received_messages();
                (base.health().state == expected).then_some(())
            });
        };
    reach(HealthState::Running, &mut board, &mut |board| {
        board.send_counts(1)
    });
    reach(HealthState::Garbage, &mut board, &mut |board| {
        board.port.send(&[0x55, 0xAA, 0, 1, 2, 3, 0]);
    });
    reach(HealthState::Running, &mut board, &mut |board| {
        board.send_counts(1)
    });
    reach(HealthState::Stalled, &mut board, &mut |_| {});
    reach(HealthState::Running, &mut board, &mut |board| {
        board.send_counts(1)
    });
    // A board that sends messages but no encoder counts is not running.
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
fn base_with_a_pressed_emergency_stop_without_encoders_or_silent_gets_no_speeds_no_kick_and_no_dribbling()
 {
    let port = PseudoSerialPort::connected();
    let queue = EventQueue::new(1024);
    let base = BaseDriver::start(
        &device(Bus::Board, port.path_string()),
        &BaseConfig::default(),
        &queue,
    )
    .expect("a base");
    let mut board = FakeBoard::new(port);
    let switches = |flags| Switches {
        flags,
        ..Switches::default()
    };
    // Commands all the time; true if the last of those received drives, false if twenty in a row do not. Kicks are counted.
    let drives = |board: &mut FakeBoard, counts: bool, flags: Option<u8>, wanted: bool| {
        let (mut drove, mut quiet, mut kicks, mut turns) = (false, 0, 0, 0);
        wait_until("the wheels", || {
            if counts {
                board.send_counts(1);
            }
            if let Some(flags) = flags {
                board.send(switches(flags));
            }
            base.handle()
                .drive(MotionCommand::WheelSpeeds([9.0; 4]), short_deadline())
                .expect("driven");
            let kick = Kick {
                speed: 2.0,
                lofted: false,
            };
            base.handle().kick(kick, short_deadline()).expect("kicked");
            let dribble = base.handle().dribble([30.0; 2], short_deadline());
            dribble.expect("dribbled");
            for message in board.received_messages() {
                match message {
                    Message::WheelCommand(command) if command.speed_crad[0] == 0 => quiet += 1,
                    Message::WheelCommand(_) => (drove, quiet) = (true, 0),
                    Message::KickCommand(_) if quiet > 10 => kicks += 1,
                    Message::DribbleCommand(command) if quiet > 10 => {
                        turns += i32::from(command.left_drad != 0);
                    }
                    _ => {}
                }
            }
            (if wanted { drove } else { quiet > 40 }).then_some(())
        });
        assert!(
            wanted || (kicks, turns) == (0, 0),
            "{kicks} kicks, {turns} commands that turn the dribbler"
        );
    };
    drives(&mut board, true, Some(0), true);
    drives(&mut board, true, Some(1), false);
    drives(&mut board, true, Some(0), true);
    drives(&mut board, false, Some(0), false);
    drives(&mut board, true, Some(0), true);
    // The port is opened anew again and again.
    drives(&mut board, false, None, false);
    drives(&mut board, true, Some(0), true);
}

#[test]
fn non_finite_command_stops_the_wheels_and_kick_is_sent_once() {
    let port = PseudoSerialPort::connected();
    let queue = EventQueue::new(1024);
    let base = BaseDriver::start(
        &device(Bus::Board, port.path_string()),
        &BaseConfig::default(),
        &queue,
    )
    .expect("a base");
    let mut board = FakeBoard::new(port);
    wait_until("speed", || {
        board.send_counts(0);
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
    let rejected = base.handle().drive(
        MotionCommand::WheelSpeeds([1.0, f32::NAN, 0.0, 0.0]),
        short_deadline(),
    );
    assert!(matches!(rejected, Err(HwError::Unsupported { .. })));
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
    // A loaded machine may send it later than the usual deadline.
    base.handle().kick(kick, hw::now() + 60.0).expect("kicked");
    let mut kicks = Vec::new();
    let mut after = 0;
    wait_until("a kick and 30 messages after it", || {
        board.send_counts(0);
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
    let port = PseudoSerialPort::connected();
    let queue = EventQueue::new(1024);
    let base = BaseDriver::start(
        &device(Bus::Board, port.path_string()),
        &BaseConfig::default(),
        &queue,
    )
    .expect("a base");
    let mut board = FakeBoard::new(port);
    let drive = || {
        base.handle()
            .drive(MotionCommand::WheelSpeeds([2.0; 4]), short_deadline())
            .expect("driven")
    };
    wait_until("speed", || {
        board.send_counts(0);
        drive();
        board
            .received_wheel_commands()
            .into_iter()
            .find(|command| command.speed_crad[0] == 200)
    });
    drive();
    assert!(base.handle().halt(Duration::from_secs(60)));
    wait_until("a stop", || {
        board
            .received_wheel_commands()
            .last()
            .filter(|command| command.speed_crad == [0; 4])
            .copied()
    });
    drive();
    drop(base);
    // A pseudo terminal passes bytes on some time after they were written.
    wait_until("a stop as the last wheel command", || {
        board
            .received_wheel_commands()
            .last()
            .filter(|command| command.speed_crad == [0; 4])
            .copied()
    });
    let missing = PseudoSerialPort::disconnected();
    let base = BaseDriver::start(
        &device(Bus::Board, missing.path_string()),
        &BaseConfig::default(),
        &queue,
    )
    .expect("a base");
    assert!(
        !base.handle().halt(Duration::from_millis(20)),
        "no bus, so no stop was sent"
    );
}

/// Command to one wheel: a speed or a current.
#[derive(Debug, Clone, Copy, PartialEq)]
enum VescSetpoint {
    Erpm(i32),
    CurrentMa(i32),
}

/// Drives three VESCs simulated by `answer` until their motors are released; returns the commands with their nodes.
fn run_vesc_drive(
    bus: Bus,
    port: &PseudoSerialPort,
    mut answer: impl FnMut(&PseudoSerialPort, &[u8], u32) -> Vec<(u8, VescSetpoint)>,
) -> Vec<(u8, VescSetpoint)> {
    let queue = EventQueue::new(1024);
    let base = BaseDriver::start(
        &device(bus, port.path_string()),
        &BaseConfig::default(),
        &queue,
    )
    .expect("a base");
    let rejected = base.handle().kick(
        Kick {
            speed: 1.0,
            lofted: false,
        },
        short_deadline(),
    );
    assert!(matches!(rejected, Err(HwError::Unsupported { .. })));
    let rotation = Twist {
        theta: 1.0,
        ..Twist::default()
    };
    let (mut log, mut ticks) = (Vec::new(), 0u32);
    let odometry = wait_until("odometry", || {
        base.handle()
            .drive(MotionCommand::Twist(rotation), short_deadline())
            .expect("driven");
        ticks = ticks.wrapping_add(3);
        log.extend(answer(port, &port.read(), ticks));
        let event = queue.pop_timeout(Duration::from_millis(1));
        event.and_then(|event| match event {
            DeviceEvent::Odometry(odometry) if odometry.dtheta > 0.0 => Some(odometry),
            _ => None,
        })
    });
    assert!(odometry.dtheta < 0.5);
    wait_until("the release", || {
        log.extend(answer(port, &port.read(), ticks));
        let released = log.iter().rev().take(3);
        (log.len() > 30
            && released
                .clone()
                .all(|(_, setpoint)| *setpoint == VescSetpoint::CurrentMa(0)))
        .then_some(())
    });
    let power = wait_for_event(&queue, "power", |event| match event {
        DeviceEvent::Power(power) => Some(power),
        _ => None,
    });
    assert!((power.battery_voltage - 24.6).abs() < 1e-4);
    log
}

/// Asserts a drive at 4 rad/s with 4096 steps per turn (the third reversed), then brake, then release.
fn assert_drive_brake_release(log: &[(u8, VescSetpoint)]) {
    let erpm = (4.0 / TAU * 60.0 * 4096.0 / 6.0) as i32;
    for (node, erpm) in [(11, erpm), (12, erpm), (13, -erpm)] {
        let mut setpoints: Vec<_> = log
            .iter()
            .filter(|(to, _)| *to == node)
            .map(|(_, setpoint)| *setpoint)
            .collect();
        setpoints.dedup();
        // The motors are released when the bus was opened.
        if setpoints.first() == Some(&VescSetpoint::CurrentMa(0)) {
            setpoints.remove(0);
        }
        // The first command is a stop, unless a drive came between the bus was open and the first command. Each drive ends
        // with a brake, and the last brake with a release. On a busy machine a command may expire before the next one.
        let driven = VescSetpoint::Erpm(erpm);
        let (brake, release) = (VescSetpoint::Erpm(0), VescSetpoint::CurrentMa(0));
        assert!(setpoints.contains(&driven), "node {node}: {setpoints:?}");
        assert!(
            setpoints.ends_with(&[driven, brake, release]),
            "node {node}: {setpoints:?}"
        );
        for pair in setpoints.windows(2) {
            let follows = match pair[0] {
                setpoint if setpoint == driven => pair[1] == brake,
                setpoint if setpoint == brake => pair[1] == driven || pair[1] == release,
                _ => pair[0] == release && (pair[1] == brake || pair[1] == driven),
            };
            assert!(follows, "node {node}: {setpoints:?}");
        }
    }
}

#[test]
fn vescs_over_uart_drive_brake_and_release() {
    let port = PseudoSerialPort::connected();
    let mut pending = Vec::new();
    let log = run_vesc_drive(Bus::VescUart, &port, |port, bytes, ticks| {
        pending.extend_from_slice(bytes);
        let mut setpoints = Vec::new();
        // A packet is 02, length, payload, three bytes.
        while pending.len() > 2 && pending.len() >= usize::from(pending[1]) + 5 {
            let packet: Vec<u8> = pending.drain(..usize::from(pending[1]) + 5).collect();
            let RoutedRequest { node, request } = Request::decode(&packet).expect("a request");
            let node = node.unwrap_or(11);
            match request {
                Request::SetRpm(erpm) => setpoints.push((node, VescSetpoint::Erpm(erpm))),
                Request::SetCurrentMa(current) => {
                    setpoints.push((node, VescSetpoint::CurrentMa(current)))
                }
                Request::GetValues => {
                    let sign = if node == 13 { -1 } else { 1 };
                    let values = Values {
                        node,
                        tachometer: sign * ticks as i32,
                        voltage_dv: 246,
                        ..Values::default()
                    };
                    port.send(&values.encode());
                }
            }
        }
        setpoints
    });
    assert_drive_brake_release(&log);
}

#[test]
fn vescs_over_slcan_drive_brake_and_release() {
    let port = PseudoSerialPort::connected();
    let mut lines = slcan::decoder();
    let mut setup = Vec::new();
    let log = run_vesc_drive(Bus::VescSlcan, &port, |port, bytes, ticks| {
        if setup.len() < 64 {
            setup.extend_from_slice(bytes);
        }
        lines.extend(bytes);
        let setpoints: Vec<_> = lines
            .by_ref()
            .filter_map(|message| match message {
                slcan::SlcanMessage::Frame(frame) => vesc_can::VescCommand::decode(&frame),
                _ => None,
            })
            .map(|Addressed { node, message }| match message {
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
        port.send(&answer);
        setpoints
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
    let rejected = BaseDriver::start(&wrong, &BaseConfig::default(), &EventQueue::new(8));
    let message = rejected.expect_err("rejected").to_string();
    assert!(
        message.contains("base.nodes") && message.contains("expected 3"),
        "{message}"
    );
}

#[test]
fn flood_of_commands_reaches_the_bus_at_its_rate_and_the_newest_one_last() {
    let port = PseudoSerialPort::connected();
    let queue = EventQueue::new(1024);
    let config = device(Bus::Board, port.path_string());
    let base = BaseDriver::start(&config, &BaseConfig::default(), &queue).expect("a base");
    let mut board = FakeBoard::new(port);
    wait_until("the first wheel command", || {
        board.send_counts(0);
        (!board.received_wheel_commands().is_empty()).then_some(())
    });
    let command = |speed: f32| {
        let speeds = MotionCommand::WheelSpeeds([speed; 4]);
        base.handle()
            .drive(speeds, short_deadline())
            .expect("driven");
    };
    let started = hw::now();
    let mut received = 0;
    while hw::now() - started < 0.5 {
        (0..100).for_each(|k| command(0.01 * k as f32));
        board.send_counts(0);
        received += board.received_wheel_commands().len();
    }
    // A repeated command may come right before a new one.
    let most = 2.0 * f64::from(config.rate_hz) * (hw::now() - started) + 10.0;
    assert!(
        received > 10 && (received as f64) < most,
        "{received} of at most {most}"
    );
    wait_until("the newest command", || {
        command(3.0);
        board.send_counts(0);
        let commands = board.received_wheel_commands();
        commands
            .last()
            .filter(|last| last.speed_crad[0] == 300)
            .map(|_| ())
    });
}
