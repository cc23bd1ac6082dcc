//! Which networks there are, and which bytes of which packages they are. Nothing of them is kept here but their digests.

use super::Set;
use super::fetch::Client;

/// A package in a registry.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Package {
    pub client: Client,
    pub name: &'static str,
    pub version: &'static str,
}

/// One network inside a package.
pub(super) struct Source {
    pub package: &'static Package,
    /// Path inside the package.
    pub member: &'static str,
    /// Bytes of that member; all of it when `None`.
    pub range: Option<(usize, usize)>,
    pub sha256: &'static str,
}

/// One network.
pub(super) struct Model {
    pub name: &'static str,
    pub file: &'static str,
    pub set: Set,
    /// In order of preference. Publications differ in metadata, not in weights.
    pub sources: &'static [Source],
}

const FACE_MESH: Package = Package { client: Client::Npm, name: "@mediapipe/face_mesh", version: "0.4.1657299874" };
const SELFIE: Package =
    Package { client: Client::Npm, name: "@mediapipe/selfie_segmentation", version: "0.1.1675465747" };
const WHEEL: Package = Package { client: Client::Pip, name: "mediapipe", version: "0.10.14" };
const FACE_MESH_DATA: &str = "package/face_mesh_solution_packed_assets.data";

pub(super) const MODELS: [Model; 4] = [
    Model {
        name: "face detection network",
        file: "face_detection_short_range.tflite",
        set: Set::Face,
        sources: &[
            Source {
                package: &FACE_MESH,
                member: FACE_MESH_DATA,
                range: Some((3_757_224, 3_986_256)),
                sha256: "3bc182eb9f33925d9e58b5c8d59308a760f4adea8f282370e428c51212c26633",
            },
            Source {
                package: &WHEEL,
                member: "mediapipe/modules/face_detection/face_detection_short_range.tflite",
                range: None,
                sha256: "bbff11cebd1eb27a1e004cae0b0e63ec8c551cbf34a4451148b4908b8db3eca8",
            },
        ],
    },
    Model {
        name: "face landmark network",
        file: "face_landmark.tflite",
        set: Set::Face,
        sources: &[
            Source {
                package: &FACE_MESH,
                member: FACE_MESH_DATA,
                range: Some((2_495_952, 3_737_848)),
                sha256: "c603fa6149219a3e9487dc9abd7a0c24474c77263273d24868378cdf40aa26d1",
            },
            Source {
                package: &WHEEL,
                member: "mediapipe/modules/face_landmark/face_landmark.tflite",
                range: None,
                sha256: "1055cb9d4a9ca8b8c688902a3a5194311138ba256bcc94e336d8373a5f30c814",
            },
        ],
    },
    Model {
        name: "person segmentation network",
        file: "selfie_segmentation.tflite",
        set: Set::Face,
        sources: &[
            Source {
                package: &SELFIE,
                member: "package/selfie_segmentation.tflite",
                range: None,
                sha256: "8d13b7fae74af625c641226813616a2117bd6bca19eb3b75574621fc08557f27",
            },
            Source {
                package: &WHEEL,
                member: "mediapipe/modules/selfie_segmentation/selfie_segmentation.tflite",
                range: None,
                sha256: "9ee168ec7c8f2a16c56fe8e1cfbc514974cbbb7e434051b455635f1bd1462f5c",
            },
        ],
    },
    Model {
        name: "iris network",
        file: "iris_landmark.tflite",
        set: Set::Irises,
        sources: &[Source {
            package: &WHEEL,
            member: "mediapipe/modules/iris_landmark/iris_landmark.tflite",
            range: None,
            sha256: "d1744d2a09c25f501d39eba4faff47e53ecca8852c5ce19bce8eeac39357521f",
        }],
    },
];
