//! Enums whose variants have names.

/// Declares an enum of variants with names: each variant has its name after `=>`. The enum gets the list `ALL`
/// and the function `name`.
///
/// ```
/// wire::named! {
///     /// A season.
///     #[derive(Clone, Copy, Debug, PartialEq)]
///     pub enum Season {
///         /// The cold one.
///         Winter => "winter",
///         /// The warm one.
///         Summer => "summer",
///     }
/// }
///
/// assert_eq!(Season::ALL.map(Season::name), ["winter", "summer"]);
/// ```
#[macro_export]
macro_rules! named {
    (
        $(#[$meta:meta])*
        $vis:vis enum $name:ident {
            $($(#[$variant_meta:meta])* $variant:ident $(= $number:expr)? => $text:expr,)+
        }
    ) => {
        $(#[$meta])*
        $vis enum $name {
            $($(#[$variant_meta])* $variant $(= $number)?,)+
        }

        impl $name {
            /// All variants, in the order of their declaration.
            $vis const ALL: [Self; [$($text),+].len()] = [$(Self::$variant),+];

            /// The name used on the command line, in files and in reports.
            #[must_use]
            $vis const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $text,)+
                }
            }
        }
    };
}
