//! Which images show nothing new? Copies of another one, whatever their files are called.

use std::collections::HashMap;

use crate::image::Image;

/// For each image that is the copy of an earlier one, the index of that one.
pub(super) fn repeated_images<'a>(images: impl Iterator<Item = &'a Image>) -> Vec<Option<usize>> {
    let mut first: HashMap<&[u8], usize> = HashMap::new();
    images
        .enumerate()
        .map(|(index, image)| {
            let earlier = *first.entry(&image.rgb).or_insert(index);
            (earlier != index).then_some(earlier)
        })
        .collect()
}
