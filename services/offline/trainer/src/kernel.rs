//! The macro that declares loops which are compiled for each instruction set.

/// Declares a function whose body is compiled once per instruction set. The function runs the body that suits
/// the processor. References among its parameters have the named lifetime. The body and all functions that it
/// calls must be plain Rust that vectorises, and `#[inline(always)]`.
macro_rules! kernel {
    (
        $(#[$doc:meta])*
        $visibility:vis fn $name:ident<$life:lifetime>($($parameter:ident: $type:ty),+ $(,)?) $body:block
    ) => {
        $(#[$doc])*
        $visibility fn $name<$life>($($parameter: $type),+) {
            struct Body<$life> {
                $($parameter: $type),+
            }

            impl nn::kernels::Kernel for Body<'_> {
                type Output = ();

                #[inline(always)]
                fn run<L: nn::kernels::Lanes>(self, _: L) {
                    let Self { $($parameter),+ } = self;
                    $body
                }
            }

            nn::kernels::dispatch(Body { $($parameter),+ });
        }
    };
}

pub(crate) use kernel;
