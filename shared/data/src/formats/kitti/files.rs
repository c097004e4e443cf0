//! The files of a KITTI sequence that belong to the named one.
//!
//! A file has the same name in all folders. Detections have one folder per class, whose name contains the
//! class: `Car`, or `pointrcnn_Car_val`. Calibration, ego motion and labels have their own folders, next to
//! that folder or further up, like `training/label_02` of KITTI itself.

use std::path::{Path, PathBuf};

use crate::open::{read_if_there, read_needed};
use crate::text::{self, Separator};
use crate::{Input, ReadError, Role};

/// Classes as in names of folders, with the type in a detection's second column.
const CLASSES: [(&str, &str, Role); 3] =
    [("Car", "2", Role::Vehicles), ("Pedestrian", "1", Role::Pedestrians), ("Cyclist", "3", Role::Cyclists)];
/// Folders with labels: of trackers' releases, and of KITTI itself.
const LABELS: [&str; 2] = ["label", "label_02"];
/// Numbers of folders to go up for the search.
const ABOVE: std::ops::Range<usize> = 2..5;

/// The named output of a detector, the outputs for other classes in folders with matching names, and the
/// files that locate them in the world.
pub(crate) fn detections(path: &Path, opened: Input) -> Result<Vec<Input>, ReadError> {
    let folder =
        path.parent().and_then(Path::file_name).and_then(|folder| folder.to_str()).unwrap_or_default();
    let file = path.file_name().unwrap_or_default();
    let named = CLASSES.iter().find_map(|(class, _, role)| Some((split(folder, class)?, *role)));
    let role = match named {
        Some((_, role)) => role,
        None => role_of(&opened)?,
    };
    let mut inputs = vec![Input { role, ..opened }];
    if let Some(([before, class, after], _)) = named {
        let is_lower = class.chars().all(char::is_lowercase);
        let folders = path.ancestors().nth(2).unwrap_or(Path::new(""));
        for (class, _, other) in CLASSES.into_iter().filter(|(.., other)| *other != role) {
            let class = if is_lower { class.to_lowercase() } else { class.to_owned() };
            let sibling = folders.join([before, &class, after].concat()).join(file);
            inputs.extend(read_if_there(&sibling, other)?);
        }
    }
    inputs.extend(sensors(path)?);
    inputs.extend(read_if_there(&place(path, &LABELS), Role::Labels)?);
    Ok(inputs)
}

/// Calibration and ego motion of the sequence to which a detector's output or a label file belongs.
pub(crate) fn sensors(path: &Path) -> Result<[Input; 2], ReadError> {
    let needed = |folder, role| read_needed(&place(path, &[folder]), role, &path.to_string_lossy());
    Ok([needed("calib", Role::Calibration)?, needed("oxts", Role::EgoMotion)?])
}

/// Labels of the sequence to which a detector's output or a label file belongs.
pub(super) fn labels(path: &Path) -> Result<Input, ReadError> {
    read_needed(&place(path, &LABELS), Role::Labels, &path.to_string_lossy())
}

/// A folder's name before the class, the class, and the rest of the name, if the class is a word of the name.
fn split<'a>(folder: &'a str, class: &str) -> Option<[&'a str; 3]> {
    let (lower, class) = (folder.to_ascii_lowercase(), class.to_ascii_lowercase());
    lower.match_indices(&class).find_map(|(at, _)| {
        let (before, rest) = folder.split_at(at);
        let (class, after) = rest.split_at(class.len());
        let is_word = !before.ends_with(char::is_alphanumeric) && !after.starts_with(char::is_alphanumeric);
        is_word.then_some([before, class, after])
    })
}

/// The class of a file by its first row, for folders that do not name the class. Any other file is read as
/// vehicles, so that the error names its first line.
fn role_of(input: &Input) -> Result<Role, ReadError> {
    let first = text::lines(input).next().transpose()?;
    let kind = first.as_ref().and_then(|line| line.pieces(Separator::Comma).nth(1));
    let known = CLASSES.iter().find(|(_, number, _)| kind.is_some_and(|(_, kind)| kind == *number));
    Ok(known.map_or(Role::Vehicles, |(.., role)| *role))
}

/// The file of the same sequence in the first of these folders that has it. The folders are searched next to
/// the file's own folder, above it, and in KITTI's training set. For detections of the test set, the test set
/// is searched instead.
fn place(path: &Path, folders: &[&str]) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let file = path.file_name().unwrap_or_default();
    let folder = path.parent().and_then(Path::file_name).unwrap_or_default().to_string_lossy();
    let set = if folder.contains("test") { "testing" } else { "training" };
    let roots = path.ancestors().take(ABOVE.end).skip(ABOVE.start);
    let roots = roots.flat_map(|root| [root.to_owned(), root.join(set), root.join("tracking").join(set)]);
    let mut places = roots.flat_map(|root| folders.iter().map(move |folder| root.join(folder).join(file)));
    let nearest = path.ancestors().nth(ABOVE.start).unwrap_or(Path::new("")).join(folders[0]).join(file);
    places.find(|place| place.is_file()).unwrap_or(nearest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_class_is_a_word_of_the_folders_name() {
        assert_eq!(split("Car", "Car"), Some(["", "Car", ""]));
        assert_eq!(split("pointrcnn_Car_val", "Car"), Some(["pointrcnn_", "Car", "_val"]));
        assert_eq!(split("my-cars_car", "Car"), Some(["my-cars_", "car", ""]));
        for folder in ["Cars", "Scare", "label_02", "Pedestrian", ""] {
            assert_eq!(split(folder, "Car"), None, "{folder}");
        }
    }
}
