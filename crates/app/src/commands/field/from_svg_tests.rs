use super::*;

fn field_of(svg: &str, scale: Option<f64>) -> Result<FieldConfig> {
    let args = Args {
        svg: "hall.svg".into(),
        out: "hall.toml".into(),
        scale,
        line_width: 0.05,
        border: 1.0,
    };
    lay_out(&read_drawing(svg, scale)?, &args)
}

#[test]
fn a_drawing_in_millimetres_becomes_a_field_in_metres_with_y_to_the_left() {
    let svg = r#"<svg width="8000mm" height="6000mm" viewBox="0 0 8000 6000">
        <rect x="1000" y="1000" width="6000" height="4000"/>
        <line x1="1000" y1="1000" x2="2000" y2="1000"/>
        <circle cx="4000" cy="3000" r="500"/></svg>"#;
    let field = field_of(svg, None).expect("a field");
    assert_eq!([field.length, field.width], [6.0, 4.0]);
    // The top left corner of the page is behind on the left: x = −3, y = +2.
    assert_eq!(field.extra_lines[4], [-3.0, 2.0, -2.0, 2.0]);
    assert_eq!(field.extra_arcs, [[0.0, 0.0, 0.5, 0.0, 360.0]]);
}

#[test]
fn groups_turn_scale_and_mirror_their_elements() {
    // A quarter circle from (1, 0) to (0, 1), mirrored by the group: then it lies above the x axis of the page.
    let svg = r#"<svg><g transform="scale(1,-1)"><g transform="translate(2 0)">
        <path d="M 1 0 A 1 1 0 0 1 0 1"/><line x1="-2" y1="-2" x2="2" y2="2"/></g></g>
        <defs><line x1="0" y1="0" x2="100" y2="0"/></defs></svg>"#;
    let field = field_of(svg, Some(1.0)).expect("a field");
    assert_eq!(field.extra_lines.len(), 1);
    let [x, y, radius, start, sweep] = field.extra_arcs[0];
    assert!((radius - 1.0).abs() < 1e-5 && (sweep - 90.0).abs() < 1e-3);
    // On the field y points up again, so the arc runs counter-clockwise from its start on the right.
    assert!(
        start.abs() < 1e-3 || (start - 360.0).abs() < 1e-3,
        "{start}"
    );
    let [x0, y0, x1, y1] = field.extra_lines[0];
    assert!((x - 0.5 * (x0 + x1)).abs() < 1e-5 && (y - 0.5 * (y0 + y1)).abs() < 1e-5);
}

#[test]
fn what_cannot_be_read_is_refused_with_a_hint() {
    let message = |svg: &str| {
        let error = field_of(svg, None).expect_err("an error");
        format!("{error:#}")
    };
    assert!(message("<svg width='100' viewBox='0 0 1 1'><line x2='1'/></svg>").contains("--scale"));
    assert!(message("<svg width='10m' viewBox='0 0 10 10'></svg>").contains("no markings"));
    assert!(
        message("<svg width='10m' viewBox='0 0 10 10'><g transform='scale(1,2)'/></svg>")
            .contains("distorts")
    );
    assert!(
        message("<svg width='10m' viewBox='0 0 10 10'><path d='M0 0Q1 1 2 2'/></svg>")
            .contains("'Q'")
    );
    assert!(
        message("<svg width='900m' viewBox='0 0 1 1'><line x2='1'/></svg>").contains("scale right")
    );
}

#[test]
fn the_shipped_drawing_is_the_shipped_field() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/fields/drawn");
    let svg = std::fs::read_to_string(folder.join("taped_hall.svg")).expect("a drawing");
    let drawn = field_of(&svg, None).expect("a field");
    let shipped = localize::Field::load(&folder.join("taped_hall.toml")).expect("a field");
    assert_eq!(drawn.line_width, shipped.config.line_width);
    let (lines, arcs) = (&shipped.config.extra_lines, &shipped.config.extra_arcs);
    let near = |a: &[f32], b: &[f32]| {
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-3)
    };
    assert!(near(drawn.extra_lines.as_flattened(), lines.as_flattened()));
    assert!(
        near(drawn.extra_arcs.as_flattened(), arcs.as_flattened()),
        "{:?}",
        drawn.extra_arcs
    );
}
