//! The built-in head is a head: human proportions, symmetric, well formed, and its parts move as parts do.

use std::collections::BTreeMap;

use heartian_artifact::{Artifact, BundleReader};

use crate::{FaceError, FramePose, HeadModel, JOINTS, Region, joint, vertex_normals};

fn landmark(head: &HeadModel, vertices: &[[f32; 3]], index: u32) -> [f32; 3] {
    let anchor = head.landmarks.iter().find(|anchor| anchor.index == index);
    anchor.map_or([f32::NAN; 3], |anchor| head.landmark_position(anchor, vertices))
}

fn gap(head: &HeadModel, vertices: &[[f32; 3]], [a, b]: [u32; 2]) -> f32 {
    let (a, b) = (landmark(head, vertices, a), landmark(head, vertices, b));
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f32>().sqrt()
}

#[test]
fn it_has_human_proportions() -> Result<(), FaceError> {
    let head = HeadModel::procedural();
    head.validate()?;
    assert!((2_000..=5_000).contains(&head.vertices.len()), "{} vertices", head.vertices.len());
    let extent = |axis: usize, keep: &dyn Fn(usize) -> bool| {
        let values = || head.vertices.iter().enumerate().filter(|(i, _)| keep(*i)).map(|(_, v)| v[axis]);
        values().fold(f32::MIN, f32::max) - values().fold(f32::MAX, f32::min)
    };
    let skull = |i: usize| head.regions[i] != Region::Ear && head.vertices[i][1] > 0.0;
    assert!((0.145..0.175).contains(&extent(0, &skull)), "width {}", extent(0, &skull));
    let chin = landmark(&head, &head.vertices, 152)[1];
    let crown = head.vertices.iter().map(|v| v[1]).fold(f32::MIN, f32::max);
    assert!((0.22..0.25).contains(&(crown - chin)), "height {}", crown - chin);
    assert!((0.085..0.095).contains(&gap(&head, &head.vertices, [33, 263])));
    assert!((0.060..0.066).contains(&(head.joints[joint::EYE_LEFT][0] - head.joints[joint::EYE_RIGHT][0])));
    for region in Region::ALL {
        assert!(head.regions.iter().filter(|own| **own == region).count() >= 20, "{region:?}");
    }
    Ok(())
}

#[test]
fn it_is_symmetric_and_landmarks_are_where_the_mesh_says() {
    let head = HeadModel::procedural();
    let quantised = |v: [f32; 3]| v.map(|c| (c * 1e4).round() as i32);
    let mut seen: BTreeMap<[i32; 3], i32> = BTreeMap::new();
    for vertex in &head.vertices {
        *seen.entry(quantised(*vertex)).or_default() += 1;
    }
    let lonely = head.vertices.iter().filter(|v| {
        let mirrored = [-v[0], v[1], v[2]];
        !(-1..=1).any(|dx| {
            let [x, y, z] = quantised(mirrored);
            (-1..=1).any(|dy| (-1..=1).any(|dz| seen.contains_key(&[x + dx, y + dy, z + dz])))
        })
    });
    assert_eq!(lonely.count(), 0, "vertices without a mirror image");
    assert!(head.landmarks.len() >= 300 && head.landmarks.windows(2).all(|pair| pair[0].index < pair[1].index));
    for pair in [[33, 263], [133, 362], [61, 291], [48, 278], [159, 386], [145, 374], [70, 300], [234, 454], [13, 13]] {
        let [right, left] = pair.map(|index| landmark(&head, &head.vertices, index));
        assert!((right[0] + left[0]).abs() < 1e-4 && right[0] <= 1e-5, "{pair:?}: {right:?} {left:?}");
        assert!((right[1] - left[1]).abs() < 1e-4 && (right[2] - left[2]).abs() < 1e-4, "{pair:?}");
    }
    let height = |index| landmark(&head, &head.vertices, index)[1];
    let column: Vec<f32> = [10, 151, 9, 8, 168, 6, 197, 195, 5, 4, 1, 2, 164, 0, 13, 14, 17, 18, 200, 152]
        .into_iter()
        .map(height)
        .collect();
    assert!(column.windows(2).all(|pair| pair[0] >= pair[1]), "{column:?}");
}

#[test]
fn triangles_face_outward() {
    let head = HeadModel::procedural();
    let normals = vertex_normals(&head.vertices, &head.triangles);
    let skin = |i: &usize| matches!(head.regions[*i], Region::Skin | Region::Scalp | Region::Brow);
    let outward = (0..normals.len()).filter(skin).filter(|&i| {
        let [x, y, z] = head.vertices[i];
        normals[i][0] * x + normals[i][1] * (y - 0.01) + normals[i][2] * (z + 0.01) > 0.0
    });
    let total = (0..normals.len()).filter(skin).count();
    assert!(outward.count() as f64 > 0.97 * total as f64);
}

#[test]
fn the_jaw_opens_the_mouth_and_the_lids_close_the_eyes() {
    let head = HeadModel::procedural();
    let rest = head.pose(&FramePose::rest(0));
    assert!(rest.as_flattened().iter().zip(head.vertices.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-6));
    let open = head.pose(&FramePose { jaw: [0.2, 0.0, 0.0], ..FramePose::rest(0) });
    assert!(gap(&head, &open, [13, 14]) > gap(&head, &rest, [13, 14]) + 0.01);
    let still = |index| {
        let (a, b) = (landmark(&head, &open, index), landmark(&head, &rest, index));
        (0..3).all(|axis| (a[axis] - b[axis]).abs() < 2e-4)
    };
    assert!([13, 0, 1, 33, 263, 10].into_iter().all(still), "what is above the mouth line stays");
    let blink = head.pose(&FramePose { eyelids: [1.0, 0.0], ..FramePose::rest(0) });
    let (left, right) = (gap(&head, &blink, [386, 374]), gap(&head, &blink, [159, 145]));
    assert!(left < 0.001 && right > 0.006, "left {left} right {right}");
    // Closing lids must not sink into the eyeball.
    for part in [0.25, 0.5, 0.75, 1.0] {
        let lids = head.pose(&FramePose { eyelids: [part; 2], ..FramePose::rest(0) });
        for index in [386, 385, 387, 374, 159, 158, 160, 145] {
            let [x, y, z] = landmark(&head, &lids, index);
            let [cx, cy, cz] = head.joints[if x > 0.0 { joint::EYE_LEFT } else { joint::EYE_RIGHT }];
            let distance = ((x - cx).powi(2) + (y - cy).powi(2) + (z - cz).powi(2)).sqrt();
            assert!(distance > 0.013, "landmark {index} at {part}: {distance}");
        }
    }
}

#[test]
fn identity_moves_joints_with_the_eyeballs_and_travels() -> Result<(), Box<dyn std::error::Error>> {
    let head = HeadModel::procedural();
    let identity: Vec<f32> = (0..head.identity.count).map(|k| (0.9 * k as f32).sin()).collect();
    let person = head.with_identity(&identity);
    person.validate()?;
    assert_eq!(person.identity.count, 0);
    for (eye, region) in [(joint::EYE_LEFT, Region::EyeLeft), (joint::EYE_RIGHT, Region::EyeRight)] {
        for (i, _) in head.regions.iter().enumerate().filter(|(_, own)| **own == region) {
            for axis in 0..3 {
                let moved = person.vertices[i][axis] - head.vertices[i][axis];
                let joint = person.joints[eye][axis] - head.joints[eye][axis];
                assert!((moved - joint).abs() < 1e-6);
            }
        }
    }
    let bytes = head.to_bundle()?.to_bytes()?;
    assert_eq!(HeadModel::from_bundle(BundleReader::new(&bytes)?)?, head);
    let broken = HeadModel { weights: vec![[0.5; JOINTS]; head.vertices.len()], ..head };
    assert!(matches!(broken.validate(), Err(FaceError::Head { .. })));
    Ok(())
}
