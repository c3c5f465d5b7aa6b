//! Changes of settings during a run: stages are replaced person by person, so that peak memory hardly grows.

use std::sync::Arc;

use super::people::{People, PipelineError, expression_and_presence};
use super::settings::Settings;
use mien_stages::base::second_core::SecondCore;
use mien_stages::expression::units::Units;
use mien_stages::face_model::FaceModel;
use mien_stages::landmarks::{LandmarkStage, Scratch};
use mien_stages::pose::PoseTracker;
use mien_stages::users::choice::Choice;

impl People {
    /// Starts or ends the second thread as the settings require.
    pub(super) fn set_second_core(&mut self, settings: &Settings) {
        let wanted = settings.second_core && settings.users.most > 1;
        if wanted != self.second_core.is_some() {
            let core = wanted.then(SecondCore::start).flatten();
            self.second_core = core.map(|core| (core, Scratch::default()));
        }
    }

    /// Applies new settings, person by person; `stages` rebuilds pose and landmarks too.
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
                // Fails for the first follower or for none.
                follower.landmarks = LandmarkStage::new(settings.landmarks, model)?;
                follower.pose = pose.for_another_head();
            }
            let (expression, presence) = expression_and_presence(settings, &units);
            follower.replace_learning(expression, presence);
        }
        let choice = Choice::new(settings.users.single);
        let before = core::mem::replace(&mut self.choice, choice);
        self.choice.adopt(&before);
        self.settings = settings.users.clone();
        self.set_second_core(settings);
        Ok(())
    }
}
