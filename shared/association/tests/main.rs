//! Tests of data association: against reference solutions and against enumeration.

mod assignment;
mod jpda;
