//! Several runs on one timeline, and the selected object.

use super::*;
use crate::view::ground_placement::GroundPlacement;
use crate::view::selection::Selection;
use crate::view::time_series::Quantity;

#[test]
fn second_log_follows_the_timeline_and_can_be_moved() {
    let mut harness = open_demo_log(PanelLayout::Watch);
    let opened = harness.state_mut().session.open_beside(log());
    opened.expect("a second run");
    harness.state_mut().session.seek(0.5);
    step_until(&mut harness, "both runs", |view| {
        let session = &view.session;
        session.findings.complete
            && session.others[0].series.samples().len() == session.series.samples().len()
    });
    let session = &harness.state().session;
    let shown = session.shown.as_ref().expect("a cycle");
    // The same log: the same pose at the same time.
    assert_eq!(session.others[0].pose(), shown.cycle.estimate.pose);
    assert_eq!(session.last_error, None);
    harness.state_mut().session.others[0].set_offset(0.25);
    harness.run_steps(2);
    let session = &harness.state().session;
    let cycle = session.others[0].cycle.as_ref().expect("a cycle");
    let behind = 0.5 - cycle.stamp.seconds();
    assert!((0.25..0.29).contains(&behind), "{behind} s");
    let (first, moved) = (
        &session.series.samples()[0],
        &session.others[0].series.samples()[0],
    );
    assert!((moved.time - first.time - 0.25).abs() < 1e-9);
    assert_eq!(
        moved.value(Quantity::LinePoints),
        first.value(Quantity::LinePoints)
    );
}

#[test]
fn scenario_beside_a_run_is_refused_with_a_reason() {
    let mut session = Session::open(log()).expect("a session");
    let refused = session.open_beside(&scenario()).expect_err("an error");
    let error = refused.to_string();
    assert!(error.contains("only a log or a robot's stream"), "{error}");
    assert!(session.others.is_empty());
}

#[test]
fn selected_object_is_listed_with_the_numbers_of_its_cycle() {
    let mut harness = open_demo_log(PanelLayout::Watch);
    harness.state_mut().session.seek(0.7);
    let session = &mut harness.state_mut().session;
    let cycle = session.shown.as_ref().expect("a cycle").cycle.clone();
    let pose = cycle.estimate.pose.expect("a pose");
    session.select_at(pose.origin(), 0.1);
    assert!(matches!(
        session.selection,
        Some(Selection::Estimate | Selection::Truth)
    ));
    let point = cycle.line_points.len() / 2;
    let placed = GroundPlacement::of(&cycle, session.viewpoint_height()).expect("a pose");
    session.select_at(placed.place(cycle.line_points[point].at), 0.1);
    let Some(Selection::LinePoint(selected)) = session.selection else {
        panic!("{:?}", session.selection);
    };
    harness.get_by_label("Details").click();
    harness.run_steps(2);
    harness.get_by_label(&format!("Line point {}", selected + 1));
    let expected = format!("{:.4} ", cycle.line_points[selected].at.x);
    harness.get_by_label(&expected);
    harness
        .state_mut()
        .session
        .select_at(localize::At::new(99.0, 99.0), 0.1);
    assert_eq!(harness.state().session.selection, None);
}

#[test]
fn points_of_a_tilted_robot_are_placed_on_the_markings() {
    let mut session = Session::open(log()).expect("a session");
    // The cycle in which the robot tilts most.
    let mut most: Option<(f32, Arc<Cycle>)> = None;
    for _ in 0..28 {
        let cycle = session.shown.as_ref().expect("a cycle").cycle.clone();
        let [a, b] = cycle.estimate.tilt;
        let tilt = a.hypot(b);
        if cycle.estimate.pose.is_some() && most.as_ref().is_none_or(|(known, _)| tilt > *known) {
            most = Some((tilt, cycle));
        }
        session.step(1);
    }
    let (tilt, cycle) = most.expect("a pose");
    assert!(tilt > 0.005, "the drive tilts the robot: {tilt} rad");
    let distances = &session.scene.as_ref().expect("a field").distances;
    let median = |viewpoint_height| {
        let seen = GroundPlacement::of(&cycle, viewpoint_height).expect("a pose");
        let points = cycle.line_points.iter();
        let places = points.map(|point| {
            let at = seen.place(point.at);
            distances.nearest(at.x, at.y).signed_distance.abs()
        });
        let mut off: Vec<f32> = places.collect();
        off.sort_by(f32::total_cmp);
        off[off.len() / 2]
    };
    let (upright, tilted) = (median(None), median(session.viewpoint_height()));
    assert!(
        tilted < 0.02 && tilted < 0.7 * upright,
        "{upright} m, {tilted} m"
    );
}
