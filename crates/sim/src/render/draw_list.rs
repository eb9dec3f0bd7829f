//! Which objects are drawn? Robots, ball, goals and the robot's own rods, as primitives in the robot frame.

use localize::field::{FieldConfig, GoalColour};
use localize::frames::{At, Pose, RobotFrame, Tf};

use super::culling::{Culling, Reach, ReachMargins};
use super::environment::Environment;
use super::panels::Panel;
use super::scene::{Scene, SceneBall};
use super::shadows::{Shadow, Underbody};
use super::solids::{LightDirection, Outline, Primitive, Solid};
use super::spheres::Sphere;
use crate::image_sensor::linear_from_srgb;
use crate::light::LightConfig;
use crate::people::Person;
use crate::world::{OTHER_HALF_SIDE, RobotState};
use localize::world::TeamColour;

/// Direction towards the light, field frame, unit vector.
const LIGHT_DIRECTION: [f32; 2] = [0.8, 0.6];
/// Ground clearance of robots' bodies, metres.
const CLEARANCE: f32 = 0.03;
/// Growth of a ball's shadow with its height: radii per radius.
const LAMP_SPREAD: f32 = 0.3;
/// Mesh and cord of a net, metres.
const NET: [f32; 2] = [0.12, 0.008];

/// All upright objects, from far to near, and the shadows on the floor.
pub(super) struct DrawList {
    pub(super) primitives: Vec<(f32, Primitive)>,
    pub(super) shadows: Vec<Shadow>,
    /// Lowest and highest slope of rays that may meet each primitive.
    pub(super) slopes: Vec<[f32; 2]>,
    /// The rays that may meet each primitive, and each shadow.
    pub(super) primitive_culling: Culling,
    pub(super) shadow_culling: Culling,
    pub(super) light_direction: LightDirection,
}

struct DrawListBuilder<'a> {
    robot_from_field: Tf<RobotFrame, localize::frames::FieldFrame>,
    light: &'a LightConfig,
    list: DrawList,
}

impl DrawList {
    pub(super) fn new(
        scene: &Scene,
        field: &FieldConfig,
        environment: &Environment,
        light: &LightConfig,
        margins: &ReachMargins,
    ) -> Self {
        let robot_from_field = scene.pose.inverse();
        let (sin, cos) = robot_from_field.theta.sin_cos();
        let [lx, ly] = LIGHT_DIRECTION;
        let draw_list = DrawList {
            primitives: Vec::new(),
            shadows: Vec::new(),
            slopes: Vec::new(),
            primitive_culling: Culling::default(),
            shadow_culling: Culling::default(),
            light_direction: [cos * lx - sin * ly, sin * lx + cos * ly],
        };
        let mut builder = DrawListBuilder {
            robot_from_field,
            light,
            list: draw_list,
        };
        for solid in &environment.clutter {
            builder.add_solid(*solid);
        }
        builder.add_goals(field);
        for robot in scene.robots {
            builder.add_robot(robot);
        }
        for person in scene.people {
            builder.add_person(person);
        }
        if let Some(ball) = &scene.ball {
            builder.add_ball(ball);
        }
        let mut draw_list = builder.list;
        // The sort is stable: parts of one robot keep their order, from the ground up.
        draw_list.primitives.sort_by(|a, b| b.0.total_cmp(&a.0));
        let reaches: Vec<Reach> = (draw_list.primitives.iter())
            .map(|(_, primitive)| primitive.reach(margins))
            .collect();
        draw_list.slopes = reaches.iter().map(|reach| reach.slope).collect();
        draw_list.primitive_culling = Culling::new(reaches.into_iter());
        let shadows = draw_list.shadows.iter();
        draw_list.shadow_culling = Culling::new(shadows.map(|shadow| shadow.reach(margins)));
        draw_list
    }
}

impl DrawListBuilder<'_> {
    fn apply_light(&self, x: f32, y: f32, colour: [f32; 3]) -> [f32; 3] {
        let (level, _) = self.light.spot_light_at(x, y);
        colour.map(|part| part * level)
    }

    /// Adds a solid given in the field frame.
    fn add_solid(&mut self, mut solid: Solid) {
        solid.side = self.apply_light(solid.x, solid.y, solid.side);
        solid.cap = self.apply_light(solid.x, solid.y, solid.cap);
        let at: At<RobotFrame> = self.robot_from_field * At::new(solid.x, solid.y);
        (solid.x, solid.y) = (at.x, at.y);
        if let Outline::Box { cos, sin, .. } = &mut solid.outline {
            let (yaw_sin, yaw_cos) = self.robot_from_field.theta.sin_cos();
            (*cos, *sin) = (
                *cos * yaw_cos - *sin * yaw_sin,
                *sin * yaw_cos + *cos * yaw_sin,
            );
        }
        self.list
            .primitives
            .push((at.distance(), Primitive::Solid(solid)));
    }

    /// Adds a league robot of 0.8 m: dark body, neck, team marker, mast and head.
    fn add_robot(&mut self, robot: &RobotState) {
        let Pose { x, y, theta, .. } = robot.pose;
        let (sin, cos) = theta.sin_cos();
        let marker = linear(match robot.team {
            TeamColour::Cyan => [30, 180, 215],
            TeamColour::Magenta => [205, 35, 150],
        });
        let body = linear([38, 38, 42]);
        let side = OTHER_HALF_SIDE;
        let square = |half: [f32; 2]| Outline::Box { half, cos, sin };
        let round = |radius: f32| Outline::Circle { radius };
        let mut part = |ahead: f32, bottom: f32, top: f32, outline: Outline, colour: [f32; 3]| {
            self.add_solid(Solid {
                x: x + cos * ahead,
                y: y + sin * ahead,
                bottom,
                top,
                outline,
                side: colour,
                cap: colour.map(|part| part * 1.3),
            });
        };
        part(0.0, CLEARANCE, 0.22, square([side, side]), body);
        part(
            -0.04,
            0.22,
            0.42,
            square([side * 0.72, side * 0.8]),
            linear([52, 52, 56]),
        );
        part(-0.04, 0.42, 0.60, round(0.12), marker);
        part(-0.04, 0.60, 0.72, round(0.04), linear([30, 30, 32]));
        part(-0.04, 0.72, 0.80, round(0.11), linear([46, 46, 50]));
        let at: At<RobotFrame> = self.robot_from_field * At::new(x, y);
        // All parts get the body's distance, so that none hides a part above it.
        let count = self.list.primitives.len();
        for primitive in &mut self.list.primitives[count - 5..] {
            primitive.0 = at.distance();
        }
        let (sin, cos) = (theta + self.robot_from_field.theta).sin_cos();
        self.list.shadows.push(Shadow {
            x: at.x,
            y: at.y,
            radius: side * 1.2,
            depth: Shadow::DEPTH,
            underbody: Underbody {
                half: side,
                cos,
                sin,
                height: CLEARANCE,
            },
        });
    }

    /// Adds a person: shoes, two legs in mid-stride, hips, upper body, arms and head.
    fn add_person(&mut self, person: &Person) {
        let Pose { x, y, theta, .. } = person.pose;
        let (sin, cos) = theta.sin_cos();
        let [trousers, shirt] = person.colours.map(linear);
        let skin = linear([196, 154, 130]);
        let round = |radius: f32| Outline::Circle { radius };
        let square = |half: [f32; 2]| Outline::Box { half, cos, sin };
        let first = self.list.primitives.len();
        let mut part =
            |[ahead, left]: [f32; 2], bottom: f32, top: f32, outline: Outline, colour: [f32; 3]| {
                self.add_solid(Solid {
                    x: x + cos * ahead - sin * left,
                    y: y + sin * ahead + cos * left,
                    bottom,
                    top,
                    outline,
                    side: colour,
                    cap: colour,
                });
            };
        let stride = person.stride();
        for (side, ahead) in [(0.1, stride), (-0.1, -stride)] {
            let shoe = square([0.14, 0.05]);
            part([ahead + 0.06, side], 0.0, 0.08, shoe, linear([45, 42, 42]));
            part([0.7 * ahead, side], 0.07, 0.5, round(0.07), trousers);
            part([0.25 * ahead, side], 0.5, 0.85, round(0.09), trousers);
            // Arms swing against the legs.
            let arm = [-0.5 * ahead, 2.5 * side];
            part(arm, 0.8, 0.95, round(0.04), skin);
            part([0.5 * arm[0], arm[1]], 0.95, 1.42, round(0.05), shirt);
        }
        part([0.0, 0.0], 0.85, 1.0, square([0.11, 0.17]), trousers);
        part([0.0, 0.0], 1.0, 1.48, square([0.12, 0.21]), shirt);
        part([0.0, 0.0], 1.52, 1.76, round(0.1), skin);
        let at: At<RobotFrame> = self.robot_from_field * At::new(x, y);
        // Parts of a person keep their order, as those of a robot.
        for primitive in &mut self.list.primitives[first..] {
            primitive.0 = at.distance();
        }
        self.list.shadows.push(Shadow {
            x: at.x,
            y: at.y,
            radius: 0.25,
            depth: Shadow::DEPTH,
            underbody: Underbody::NONE,
        });
    }

    /// Adds a ball. Higher up, its shadow is larger and fainter: the lamps of a hall cover part of the ceiling.
    fn add_ball(&mut self, ball: &SceneBall) {
        let radius = ball.diameter / 2.0;
        let colour = self.apply_light(ball.at.x, ball.at.y, linear(ball.colour));
        let at: At<RobotFrame> = self.robot_from_field * ball.at;
        let wider = 1.0 + LAMP_SPREAD * ball.height / radius;
        let sphere = Sphere {
            x: at.x,
            y: at.y,
            bottom: ball.height,
            radius,
            colour,
        };
        self.list
            .primitives
            .push((at.distance(), Primitive::Sphere(sphere)));
        self.list.shadows.push(Shadow {
            x: at.x,
            y: at.y,
            radius: radius * 0.9 * wider,
            depth: Shadow::DEPTH / (wider * wider),
            underbody: Underbody::NONE,
        });
    }

    /// Posts and crossbar with a net, or a box of coloured walls.
    fn add_goals(&mut self, field: &FieldConfig) {
        let goal = &field.goal;
        if goal.width <= 0.0 || goal.height <= 0.0 {
            return;
        }
        for (side, colour) in [(1.0, goal.colours[0]), (-1.0, goal.colours[1])] {
            let line = side * field.length / 2.0;
            let (paint, mesh) = match colour {
                GoalColour::White => (linear([225, 225, 222]), Some(NET)),
                GoalColour::Blue => (linear([35, 70, 185]), None),
                GoalColour::Yellow => (linear([225, 195, 40]), None),
            };
            let posts = match colour {
                GoalColour::White => paint,
                _ => linear([225, 225, 222]),
            };
            let half_post = goal.post / 2.0;
            let beam = |half: [f32; 2]| Outline::Box {
                half,
                cos: 1.0,
                sin: 0.0,
            };
            let mut add_beam = |y: f32, bottom: f32, top: f32, outline: Outline| {
                self.add_solid(Solid {
                    x: line,
                    y,
                    bottom,
                    top,
                    outline,
                    side: posts,
                    cap: posts,
                });
            };
            if goal.post > 0.0 {
                for across in [1.0, -1.0] {
                    let y = across * (goal.width / 2.0 + half_post);
                    add_beam(y, 0.0, goal.height, beam([half_post, half_post]));
                }
                let bar = beam([half_post, goal.width / 2.0 + goal.post]);
                add_beam(0.0, goal.height, goal.height + goal.post, bar);
            }
            if goal.depth > 0.0 {
                let back = line + side * goal.depth;
                let half = goal.width / 2.0;
                for (from, to) in [
                    ([back, -half], [back, half]),
                    ([line, -half], [back, -half]),
                    ([line, half], [back, half]),
                ] {
                    self.add_panel(from, to, goal.height, paint, mesh);
                }
            }
        }
    }

    fn add_panel(
        &mut self,
        from: [f32; 2],
        to: [f32; 2],
        top: f32,
        colour: [f32; 3],
        mesh: Option<[f32; 2]>,
    ) {
        let (x, y) = ((from[0] + to[0]) / 2.0, (from[1] + to[1]) / 2.0);
        let colour = self.apply_light(x, y, colour);
        let to_robot_frame = |end: [f32; 2]| {
            let at: At<RobotFrame> = self.robot_from_field * At::new(end[0], end[1]);
            [at.x, at.y]
        };
        let (from, to) = (to_robot_frame(from), to_robot_frame(to));
        let middle = At::<RobotFrame>::new((from[0] + to[0]) / 2.0, (from[1] + to[1]) / 2.0);
        let panel = Panel {
            from,
            to,
            top,
            colour,
            mesh,
        };
        self.list
            .primitives
            .push((middle.distance(), Primitive::Panel(panel)));
    }
}

/// Linear colours of an sRGB triple.
pub(super) fn linear(colour: [u8; 3]) -> [f32; 3] {
    colour.map(linear_from_srgb)
}
