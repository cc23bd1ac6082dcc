//! Where a head's irises are: on eyeballs about the eye joints.

use glam::{DVec3, Vec3};

use crate::model::{HeadModel, Region, joint};
use crate::track::FramePose;

/// Half the angle under which an iris is seen from its eyeball's centre, radians: 6 mm on a ball of 12 mm radius.
const IRIS_RADIANS: f64 = 0.49;
/// Regions and joints of the left and of the right eye.
const EYES: [(Region, usize); 2] = [(Region::EyeLeft, joint::EYE_LEFT), (Region::EyeRight, joint::EYE_RIGHT)];

/// One eyeball at rest, head space, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct EyeBall {
    pub centre: DVec3,
    pub radius: f64,
}

impl EyeBall {
    /// From the ball's centre to that of the iris's disc.
    pub fn iris_distance(&self) -> f64 {
        self.radius * IRIS_RADIANS.cos()
    }
}

/// An iris of a posed head.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iris {
    /// Centre of its disc, world space, metres.
    pub centre: [f32; 3],
    /// Radius of its disc, metres.
    pub radius: f32,
}

impl HeadModel {
    /// Left and right eyeball; `None` for a head without them. Bake the identity first.
    pub(crate) fn eyeballs(&self) -> [Option<EyeBall>; 2] {
        EYES.map(|(region, eye)| {
            let centre = DVec3::from_array(self.joints[eye].map(f64::from));
            let own = self.vertices.iter().zip(&self.regions).filter(|(_, own)| **own == region);
            let radius =
                own.map(|(vertex, _)| DVec3::from_array(vertex.map(f64::from)).distance(centre)).fold(0.0, f64::max);
            (radius > 0.0).then_some(EyeBall { centre, radius })
        })
    }

    /// Left and right iris of a pose; `None` for a head without eyeballs. Bake the identity first.
    pub fn irises(&self, pose: &FramePose) -> [Option<Iris>; 2] {
        let transforms = self.joint_transforms(pose);
        let balls = self.eyeballs();
        std::array::from_fn(|eye| {
            let ball = balls[eye]?;
            let at = (ball.centre + DVec3::Z * ball.iris_distance()).as_vec3();
            let centre: Vec3 = transforms[EYES[eye].1].transform_point3(at);
            Some(Iris { centre: centre.to_array(), radius: (ball.radius * IRIS_RADIANS.sin()) as f32 })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_eye_that_turns_left_moves_its_iris_left() {
        let head = HeadModel::procedural();
        let rest = head.irises(&FramePose::rest(0));
        let turned = head.irises(&FramePose { eyes: [[0.0, 0.3, 0.0]; 2], ..FramePose::rest(0) });
        for (before, after) in rest.into_iter().zip(turned) {
            let (Some(before), Some(after)) = (before, after) else { panic!("the built-in head has eyes") };
            assert!(after.centre[0] > before.centre[0] + 0.002 && (after.centre[1] - before.centre[1]).abs() < 1e-6);
            assert!((0.004..0.008).contains(&before.radius), "{}", before.radius);
        }
    }
}
