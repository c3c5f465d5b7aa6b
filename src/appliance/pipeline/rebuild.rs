//! Other settings during a run: stages are replaced one person after the other, so that hardly more memory is needed than before.

use std::sync::Arc;

use super::people::{People, PipelineError, learning};
use super::settings::Settings;
use mien_stages::base::second_core::SecondCore;
use mien_stages::expression::units::Units;
use mien_stages::face_model::FaceModel;
use mien_stages::landmarks::{LandmarkStage, Scratch};
use mien_stages::pose::PoseTracker;
use mien_stages::users::choice::Choice;

impl People {
    /// Starts or ends the second thread.
    pub(super) fn share(&mut self, settings: &Settings) {
        let shares = settings.second_core && settings.users.most > 1;
        if shares != self.second.is_some() {
            let core = shares.then(SecondCore::start).flatten();
            self.second = core.map(|core| (core, Scratch::default()));
        }
    }

    /// Takes other settings, person by person; pose and landmarks are built anew if `stages` differ.
    ///
    /// # Errors
    /// As [`Self::new`]; nothing has changed then.
    pub(super) fn rebuild(
        &mut self,
        settings: &Settings,
        model: &FaceModel,
        stages: bool,
    ) -> Result<(), PipelineError> {
        let pose = stages
            .then(|| PoseTracker::new(settings.pose, &model.standard_head))
            .transpose()?;
        let units = Arc::new(Units::shipped());
        for follower in &mut self.followers {
            if let Some(pose) = &pose {
                // It fails for the first one or for none.
                follower.landmarks = LandmarkStage::new(settings.landmarks, model)?;
                follower.pose = pose.for_another_head();
            }
            let (expression, presence) = learning(settings, &units);
            follower.learn_with(expression, presence);
        }
        let choice = Choice::new(settings.users.single);
        let before = core::mem::replace(&mut self.choice, choice);
        self.choice.adopt(&before);
        self.settings = settings.users.clone();
        self.share(settings);
        Ok(())
    }
}
