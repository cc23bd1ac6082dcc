//! DatasetExporter: a clip and its pulse in the layout of a public data set.

use heartian_capture::export::{AviForm, Layout, Place, labels, png, write_clip};
use heartian_graph::{Context, Files, Inputs, Node, NodeError, Outputs, Port, params, register};
use heartian_space::{Clip, Series};

params! {
    /// Lays a clip and its pulse out as a public data set does, so that rPPG-Toolbox and its like read the avatar as they
    /// read a recording. The person is shown over black.
    pub struct DatasetExporter {
        /// Ubfc: subjectN/vid.avi (raw BGR24) and ground_truth.txt. Pure: SS-TT/SS-TT/*.png and SS-TT.json.
        layout: Layout = Layout::Ubfc, choices(&["Ubfc", "Pure"]);
        /// Number of the subject.
        subject: u32 = 1, range(1.0, 9999.0);
        /// Number of the subject's recording; UBFC-rPPG has one a subject.
        recording: u32 = 1, range(1.0, 99.0);
        /// The heart rate that is written beside the pulse; readers ignore it.
        heart_rate_bpm: Option<f64> = None, unit("bpm"), range(30.0, 220.0);
    }
}
register!(DatasetExporter);

impl Node for DatasetExporter {
    const KIND: &'static str = "DatasetExporter";
    const REVISION: u32 = 1;
    const INPUTS: &'static [Port] = &[
        Port::one::<Clip>("clip", "The frames."),
        Port::one::<Series>("ppg", "The pulse in them, at any rate, on the clip's clock."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one::<Files>("files", "The data set's folder.")];

    fn run(&self, inputs: &Inputs, context: &Context) -> Result<Outputs, NodeError> {
        let (clip, ppg) = (inputs.get::<Clip>("clip")?, inputs.get::<Series>("ppg")?);
        let place = Place { layout: self.layout, subject: self.subject, recording: self.recording };
        let rate = self.heart_rate_bpm.unwrap_or(f64::NAN);
        let text = labels(self.layout, &clip.times_seconds, &ppg, rate).map_err(|error| {
            NodeError::from(error).remedy("wire a pulse that covers the clip, such as phase.target or frames.ppg")
        })?;
        let mut files = Files::new().with(&place.labels(), text.into_bytes())?;
        match self.layout {
            Layout::Ubfc => {
                let Some(size) = AviForm::of(&clip).size() else {
                    let error = NodeError::new("the clip does not fit an AVI file of 4 GiB").parameter("layout");
                    return Err(error.remedy("export fewer or smaller frames, or layout: Pure"));
                };
                let mut bytes = Vec::with_capacity(size as usize);
                write_clip(&clip, &mut bytes)?;
                files = files.with(&place.frames(0.0), bytes)?;
            }
            Layout::Pure => {
                for index in 0..clip.len() {
                    let picture = png(&clip.image_over_black(index))?;
                    files = files.with(&place.frames(clip.times_seconds[index]), picture)?;
                    if context.progress(index as u64 + 1, clip.len() as u64, None).is_break() {
                        return Err(NodeError::cancelled());
                    }
                }
            }
        }
        Ok(Outputs::new().put("files", files))
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use heartian_graph::AnyArtifact;
    use heartian_space::Sequence;

    use super::*;

    #[test]
    fn a_clip_becomes_a_folder_of_either_layout() {
        let sequence = Sequence { frames: vec![9; 3 * 12], alpha: vec![255; 12], times_seconds: vec![0.0, 0.04, 0.08] };
        let clip = Clip::new("rendered", 2, 2, sequence).unwrap();
        let ppg = Series::new(vec![0.0, 0.05, 0.1], vec![0.0, 1.0, 0.5]).unwrap();
        let inputs = || Inputs::new().with("clip", AnyArtifact::new(clip.clone()));
        let names = |layout, ppg: &Series| {
            let node = DatasetExporter { layout, subject: 4, ..DatasetExporter::default() };
            let outputs = node.run(&inputs().with("ppg", AnyArtifact::new(ppg.clone())), &Context::silent())?;
            let files = outputs.get("files").unwrap().downcast::<Files>().unwrap();
            Ok::<_, NodeError>(files.iter().map(|(name, _)| name.to_owned()).collect::<Vec<_>>())
        };
        assert_eq!(names(Layout::Ubfc, &ppg).unwrap(), ["subject4/ground_truth.txt", "subject4/vid.avi"]);
        let pure = names(Layout::Pure, &ppg).unwrap();
        assert_eq!((pure.len(), pure[0].as_str()), (4, "04-01/04-01.json"));
        assert!(pure[2] < pure[3] && pure[1].ends_with("Image0000000000000000000.png"), "{pure:?}");
        let short = Series::new(vec![0.5, 0.6], vec![0.0, 1.0]).unwrap();
        assert!(names(Layout::Ubfc, &short).unwrap_err().remedy.is_some());
    }
}
