//! Curves: quantities, fields of topics, and formulas.

use pipeline::log::columns::TopicReader;

use super::*;
use crate::view::curves::CurveState;

#[test]
fn quantity_is_found_by_typing_and_plotted() {
    let mut harness = open_demo_log(PanelLayout::Watch);
    harness.get_by_label("Add plot").click();
    harness.run_steps(2);
    harness.get_by_label("name of a curve").focus();
    harness.run_steps(1);
    harness
        .get_by_label("name of a curve")
        .type_text("markings seen");
    harness.run_steps(2);
    harness.get_by_label("markings seen (%)").click();
    harness.run_steps(3);
    let shown = |harness: &Harness<'_, View>| {
        harness
            .query_all_by(|node| {
                node.label()
                    .is_some_and(|label| label.starts_with("markings seen"))
            })
            .count()
    };
    assert!(shown(&harness) > 0, "a curve with its value");
}

/// Waits until a requested curve is complete.
fn read_curve(harness: &mut Harness<'_, View>, name: &str) {
    harness.state_mut().session.curves.request(name);
    step_until(harness, name, |view| {
        view.session.curves.state(name) == CurveState::Complete
            && view
                .session
                .curve(name)
                .is_some_and(|curve| curve.len() > 0)
    });
}

#[test]
fn field_of_a_topic_is_found_by_typing_and_has_the_values_of_the_log() {
    let mut harness = open_demo_log(PanelLayout::Watch);
    step_until(&mut harness, "the fields", |view| {
        !view.session.curves.paths().is_empty()
    });
    harness.get_by_label("Add plot").click();
    harness.run_steps(2);
    harness.get_by_label("name of a curve").focus();
    harness.run_steps(1);
    harness
        .get_by_label("name of a curve")
        .type_text("imu rate_z");
    harness.run_steps(2);
    harness.get_by_label("/imu.rate_z").click();
    harness.run_steps(3);
    read_curve(&mut harness, "/imu.rate_z");
    let reader = TopicReader::open(log()).expect("a log");
    let (times, columns) = reader
        .columns("/imu", &[], &(0..u64::MAX), || Ok(()))
        .expect("columns");
    let rates = columns.iter().find(|(name, _)| name == "rate_z");
    let Some((_, pipeline::log::columns::ColumnData::F64(rates))) = rates else {
        panic!("no column");
    };
    let curve = harness.state().session.curve("/imu.rate_z");
    let curve = curve.expect("a curve");
    assert_eq!(curve.len(), rates.len());
    for (index, (time, rate)) in times.iter().zip(rates).enumerate() {
        assert_eq!(curve.point(index), [*time as f64 * 1e-9, *rate]);
    }
}

#[test]
fn formula_is_computed_from_quantities_and_fields() {
    let mut harness = open_demo_log(PanelLayout::Watch);
    let name = "= {/truth/error.distance} * 100 - {position error}";
    step_until(&mut harness, "the metrics", |view| {
        view.session.findings.complete
    });
    read_curve(&mut harness, name);
    let curve = harness.state().session.curve(name).expect("a curve");
    let values: Vec<f64> = (0..curve.len())
        .map(|index| curve.point(index)[1])
        .collect();
    assert!(values.len() >= 29, "{}", values.len());
    let largest = values.iter().map(|value| value.abs()).fold(0.0, f64::max);
    assert!(largest < 1e-4, "both are the position error: {largest} cm");
}

#[test]
fn unknown_field_says_why() {
    let mut harness = open_demo_log(PanelLayout::Watch);
    let name = "/imu.nothing";
    harness.state_mut().session.curves.request(name);
    step_until(&mut harness, "an answer", |view| {
        view.session.curves.state(name) != CurveState::Reading
    });
    let state = harness.state().session.curves.state(name);
    let CurveState::Failed(reason) = state else {
        panic!("{state:?}");
    };
    assert!(reason.contains("has no field nothing"), "{reason}");
}

#[test]
fn fields_of_a_live_run_follow_its_cycles() {
    let session = Session::open(&scenario()).expect("a simulation");
    let mut harness = harness(session, PanelLayout::Watch);
    let name = "/cycle.estimate.line_points";
    harness.state_mut().session.curves.request(name);
    harness.state_mut().session.playback.playing = true;
    step_until(&mut harness, "cycles", |view| {
        view.session
            .curve(name)
            .is_some_and(|curve| curve.len() > 5)
    });
    let session = &harness.state().session;
    let curve = session.curve(name).expect("a curve");
    let last = session.series.samples().last().expect("a cycle");
    assert_eq!(curve.point(curve.len() - 1)[0], last.time);
}
