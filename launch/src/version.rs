use nn::Weights;

/// Version of the program, with what else decides its numbers: the weights that it carries and the kernels of this CPU.
pub fn text() -> String {
    format!(
        "stgdat {}\nweights {}\nkernels {}\n",
        env!("CARGO_PKG_VERSION"),
        Weights::onboard().sha256(),
        nn::kernels::active().name()
    )
}
