//! An avatar in one pose as plain 3D Gaussians with one colour each, for programs that know no head, light or material.
//!
//! Frame of the result: metres, x right, y down, z away from the viewer, the convention of 3D Gaussian splatting files (the
//! world turned by half a turn about x). Colour: albedo under the light's irradiance at the Gaussian's normal,
//! sRGB-encoded; highlights need the viewer's direction and are left out.

use glam::{DMat4, Quat, Vec3};
use heartian_space::color::srgb_from_linear;
use heartian_splat::{Environment, RawGaussians};

use crate::AvatarError;
use crate::avatar::Avatar;
use crate::deform::{Motion, deform};
use crate::light::irradiance;
use crate::rig::JOINTS;

/// The pose that is baked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BakedPose {
    /// The head at rest: at the world's origin, facing the viewer, no expression.
    Neutral,
    /// A frame of the recording, where it was in the world.
    Frame(usize),
}

/// Bakes the pose under the avatar's light, or another.
///
/// # Errors
/// When the frame does not exist.
pub fn bake(avatar: &Avatar, pose: BakedPose, light: Option<&Environment>) -> Result<RawGaussians, AvatarError> {
    let motion = match pose {
        BakedPose::Neutral => {
            let coefficients = avatar.motion.range.iter().map(|[least, most]| 0.0f32.clamp(*least, *most)).collect();
            Motion { joints: [DMat4::IDENTITY; JOINTS], coefficients }
        }
        BakedPose::Frame(index) => {
            let missing = || AvatarError::Index { what: "the pose to bake", index, count: avatar.states.len() };
            avatar.motion.motion(avatar.states.get(index).ok_or_else(missing)?)
        }
    };
    let deformed = deform(&avatar.canonical, &motion);
    let light = light.unwrap_or(&avatar.environment);
    let eye = avatar.camera.centre_in_world();
    let canonical = &avatar.canonical;
    let mut out = RawGaussians {
        log_scales: canonical.log_scales.as_chunks::<3>().0.to_vec(),
        logits: canonical.opacity_logits.clone(),
        ..RawGaussians::default()
    };
    let rows = deformed.positions.as_chunks::<3>().0.iter().zip(deformed.rotations.as_chunks::<4>().0);
    for (index, (position, [w, x, y, z])) in rows.enumerate() {
        let (position, rotation) = (Vec3::from_array(*position), Quat::from_xyzw(*x, *y, *z, *w));
        let normal = rotation * Vec3::Z;
        // At rest the head looks along +z, as in a recording it looks at the camera.
        let toward = if pose == BakedPose::Neutral { Vec3::Z } else { eye - position };
        let normal = if normal.dot(toward) < 0.0 { -normal } else { normal };
        let (albedo, shade) = (canonical.albedo(index), irradiance(light, normal));
        out.colors.push(std::array::from_fn(|channel| srgb_from_linear((albedo[channel] * shade[channel]).min(1.0))));
        out.means.push([position.x, -position.y, -position.z]);
        // Half a turn about x, before the rotation.
        out.rotations.push([-x, *w, -z, *y]);
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_a_turn_about_x_is_what_the_rotations_get() {
        let q = Quat::from_xyzw(0.1, -0.4, 0.3, 0.8).normalize();
        let expected = Quat::from_xyzw(1.0, 0.0, 0.0, 0.0) * q;
        let found = Quat::from_xyzw(q.w, -q.z, q.y, -q.x);
        assert!(expected.abs_diff_eq(found, 1e-6), "{expected} {found}");
    }
}
