use nn::{Precision, Weights};
use run::Run;
use wire::StageId;

/// Version of the program, SHA-256 of the embedded weights and the kernels of this CPU, which decide its
/// numbers.
pub fn text() -> String {
    format!(
        "stgdat {}\nweights {}\nkernels {}\n",
        env!("CARGO_PKG_VERSION"),
        Weights::onboard().sha256(),
        nn::kernels::active().name()
    )
}

/// In which precision a run's stages multiply, where not all of them do so in f32.
pub fn precision(run: &Run) -> Option<String> {
    // The options of a program of the user's own are not ours to read.
    run.stage(StageId::Decoder).filter(|stage| stage.built_in)?;
    let precision = decoder::STAGE.options(run).ok()?.precision;
    (precision != Precision::F32).then(|| format!("decoder in {precision}"))
}

/// The kernels of this process and the precision of a run's stages, which decide its numbers.
pub fn kernels(run: &Run) -> String {
    let kernels = nn::kernels::active().name().to_owned();
    precision(run).map_or(kernels.clone(), |precision| format!("{kernels}, {precision}"))
}
