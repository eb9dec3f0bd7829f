//! Bases that do not follow: a slow line, a board that receives nothing, a clock that stands still, a silent controller.

use crate::fake_board::{FakeBoard, device, short_deadline};
use crate::pseudo_terminal::{PseudoSerialPort, wait_until};
use hw::base::{Kick, MotionCommand};
use hw::config::{BaseDeviceConfig, Bus};
use hw::wire::board::{Encoders, Message, Switches};
use hw::wire::vesc::{Request, RoutedRequest, Values};
use hw::{BaseDriver, DeviceEvent, EventQueue, HealthState};
use localize::robot::BaseConfig;

fn start(config: &BaseDeviceConfig, queue: &EventQueue) -> BaseDriver {
    BaseDriver::start(config, &BaseConfig::default(), queue).expect("a base")
}

fn drive(base: &BaseDriver) {
    let speeds = MotionCommand::WheelSpeeds([2.0; 4]);
    base.handle()
        .drive(speeds, short_deadline())
        .expect("driven");
}

#[test]
fn slow_line_gets_no_more_bytes_than_it_carries_and_is_named() {
    let port = PseudoSerialPort::connected();
    let queue = EventQueue::new(1024);
    let config = BaseDeviceConfig {
        baud: 9600,
        ..device(Bus::Board, port.path_string())
    };
    let rate_max = hw::base::command_rate_max(&config, &BaseConfig::default());
    assert!(
        rate_max.is_some_and(|most| (30.0..48.0).contains(&most)),
        "{rate_max:?}"
    );
    let base = start(&config, &queue);
    let mut board = FakeBoard::new(port);
    let mut reason = None;
    let started = hw::now();
    let (mut bytes, mut driven) = (0.0, 0);
    while hw::now() - started < 1.5 || driven == 0 {
        board.send_counts(0);
        drive(&base);
        let kick = Kick {
            speed: 2.0,
            lofted: false,
        };
        base.handle().kick(kick, short_deadline()).expect("kicked");
        for message in board.received_messages() {
            bytes += match message {
                Message::WheelCommand(command) => {
                    driven += i32::from(command.speed_crad[0] != 0);
                    20.0
                }
                _ => 14.0,
            };
        }
        while let Some(event) = queue.pop_timeout(std::time::Duration::ZERO) {
            if let DeviceEvent::Health(health) = event {
                reason = health
                    .reason
                    .filter(|reason| reason.contains("baud"))
                    .or(reason);
            }
        }
    }
    let carried = 960.0 * (hw::now() - started);
    assert!(bytes < carried + 40.0, "{bytes} bytes, {carried} carried");
    assert!(reason.is_some_and(|reason| reason.contains("9600 baud carry")));
    // The stop counts once the line has carried it.
    assert!(base.handle().halt(std::time::Duration::from_secs(60)));
}

#[test]
fn board_that_reports_expired_commands_while_it_is_driven_gets_no_speeds_and_no_kick_and_is_named()
{
    let port = PseudoSerialPort::connected();
    let queue = EventQueue::new(1024);
    let base = start(&device(Bus::Board, port.path_string()), &queue);
    let mut board = FakeBoard::new(port);
    let step = |board: &mut FakeBoard, flags| {
        board.send_counts(0);
        board.send(Switches {
            time_us: (hw::now().0 / 1000) as u32,
            bumpers: 0,
            flags,
        });
        drive(&base);
        board.received_messages()
    };
    wait_until("speeds", || {
        step(&mut board, 0);
        (base.health().state == HealthState::Running).then_some(())
    });
    assert_eq!(base.handle().obstacle(), None);
    let reason = wait_until("the report", || {
        step(&mut board, 2);
        base.health().reason
    });
    assert!(reason.contains("does not receive them"), "{reason}");
    assert!(
        base.handle()
            .obstacle()
            .is_some_and(|text| text.contains("does not receive them"))
    );
    let mut messages = Vec::new();
    let kick = Kick {
        speed: 2.0,
        lofted: false,
    };
    while messages.len() < 20 {
        base.handle().kick(kick, short_deadline()).expect("kicked");
        messages.extend(step(&mut board, 2));
    }
    assert!(!messages.iter().any(|message| match message {
        Message::KickCommand(_) => true,
        Message::WheelCommand(command) => command.speed_crad != [0; 4],
        _ => false,
    }));
    wait_until("speeds again", || {
        let messages = step(&mut board, 0);
        messages
            .iter()
            .any(|message| matches!(message, Message::WheelCommand(command) if command.speed_crad[0] != 0))
            .then_some(())
    });
    wait_until("a kick", || {
        base.handle().kick(kick, short_deadline()).expect("kicked");
        let messages = step(&mut board, 0);
        messages
            .iter()
            .any(|message| matches!(message, Message::KickCommand(_)))
            .then_some(())
    });
    wait_until("the emergency stop", || {
        step(&mut board, 1);
        base.handle()
            .obstacle()
            .filter(|text| text.contains("emergency stop"))
    });
}

#[test]
fn board_whose_clock_stands_still_is_driven_and_named() {
    let port = PseudoSerialPort::connected();
    let queue = EventQueue::new(1024);
    let base = start(&device(Bus::Board, port.path_string()), &queue);
    let mut board = FakeBoard::new(port);
    let started = hw::now();
    let (mut commands, mut reasons) = (Vec::new(), Vec::new());
    let (mut count, mut newest) = (0, started);
    while hw::now() - started < 1.5 || commands.len() < 50 {
        count += 4;
        board.send(Encoders {
            time_us: 0,
            count: [count, count, 0u32.wrapping_sub(count), 0],
        });
        drive(&base);
        commands.extend(board.received_wheel_commands());
        while let Some(event) = queue.pop_timeout(std::time::Duration::ZERO) {
            match event {
                DeviceEvent::Odometry(odometry) => newest = odometry.stamp,
                DeviceEvent::Health(health) => reasons.push((health.state, health.reason)),
                _ => {}
            }
        }
    }
    assert!(
        !reasons
            .iter()
            .any(|(state, _)| *state == HealthState::Stalled),
        "{reasons:?}"
    );
    let (state, reason) = reasons.pop().expect("a report");
    assert_eq!(state, HealthState::Clock, "{reason:?}");
    assert!(reason.is_some_and(|text| text.contains("stamped on arrival")));
    assert!(
        newest - started > 1.0,
        "the stamps go on: {}",
        newest - started
    );
    let first = commands
        .iter()
        .position(|command| command.speed_crad[0] != 0);
    let interrupted = commands[first.expect("speeds")..]
        .iter()
        .filter(|command| command.speed_crad[0] == 0);
    // A loaded machine may command too late now and then.
    assert!(2 * interrupted.count() < commands.len());
}

/// Answers the polls of all controllers but the `silent` ones; returns the speeds that were commanded.
fn answer_vescs(port: &PseudoSerialPort, pending: &mut Vec<u8>, silent: &[u8]) -> Vec<i32> {
    pending.extend(port.read());
    let mut speeds = Vec::new();
    // A packet is 02, length, payload, three bytes.
    while pending.len() > 2 && pending.len() >= usize::from(pending[1]) + 5 {
        let packet: Vec<u8> = pending.drain(..usize::from(pending[1]) + 5).collect();
        let RoutedRequest { node, request } = Request::decode(&packet).expect("a request");
        let node = node.unwrap_or(11);
        match request {
            Request::SetRpm(erpm) => speeds.push(erpm),
            Request::SetCurrentMa(_) => speeds.push(0),
            Request::GetValues if silent.contains(&node) => {}
            Request::GetValues => port.send(
                &Values {
                    node,
                    ..Values::default()
                }
                .encode(),
            ),
        }
    }
    speeds
}

#[test]
fn silent_controllers_are_named_and_all_wheels_are_braked() {
    let port = PseudoSerialPort::connected();
    let queue = EventQueue::new(1024);
    let base = start(&device(Bus::VescUart, port.path_string()), &queue);
    let mut pending = Vec::new();
    let mut reach = |silent: &[u8], wanted: &str, drives: bool| {
        let (mut braked, mut named) = (0, false);
        wait_until(wanted, || {
            drive(&base);
            let speeds = answer_vescs(&port, &mut pending, silent);
            let is_driven = speeds.iter().any(|speed| *speed != 0);
            braked = if is_driven { 0 } else { braked + speeds.len() };
            let reason = base.health().reason.unwrap_or_default();
            named = reason.starts_with(wanted);
            let is_reached = if drives { is_driven } else { braked > 60 };
            (named && is_reached).then_some(())
        });
    };
    reach(&[], "", true);
    reach(&[12], "controller 12 of wheel 1 is silent", false);
    reach(
        &[12, 13],
        "controllers 12 of wheel 1, 13 of wheel 2 are silent",
        false,
    );
    reach(&[], "", true);
    // In a new connection nothing drives before each controller has reported.
    drop(base);
    let base = start(&device(Bus::VescUart, port.path_string()), &queue);
    let mut speeds = Vec::new();
    while speeds.len() < 30 {
        drive(&base);
        speeds.extend(answer_vescs(&port, &mut pending, &[11]));
    }
    assert!(speeds.iter().all(|speed| *speed == 0), "{speeds:?}");
}
