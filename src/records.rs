//! Records of what is done, for whoever subscribes to them through `tracing`.

use std::time::Instant;

use tracing::info;

/// A stage: its begin and its end are recorded, the end with the time it took.
pub(crate) struct Stage {
    name: &'static str,
    begun: Instant,
}

impl Stage {
    pub(crate) fn begin(name: &'static str) -> Self {
        info!("{name}: begun");
        Self { name, begun: Instant::now() }
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        info!("{}: ended after {:.3} s", self.name, self.begun.elapsed().as_secs_f64());
    }
}
