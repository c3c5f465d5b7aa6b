//! Sorting of short lists. The standard library's sort is designed for long ones and adds eight kilobytes to the program
//! for every type it is used with.

/// Sorts by a key, stably, in place; the time grows with the square of the length.
pub(crate) fn sort_by_key<T, K: Ord>(list: &mut [T], key: impl Fn(&T) -> K) {
    for end in 1..list.len() {
        let mut at = end;
        while at > 0 && key(&list[at - 1]) > key(&list[at]) {
            list.swap(at - 1, at);
            at -= 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::sort_by_key;

    #[test]
    fn in_order_and_equals_as_they_were() {
        let mut random = fastrand::Rng::with_seed(1);
        for length in 0..30 {
            let mut list: Vec<(u8, usize)> = (0..length).map(|i| (random.u8(..9), i)).collect();
            let mut expected = list.clone();
            expected.sort_by_key(|&(key, _)| key);
            sort_by_key(&mut list, |&(key, _)| key);
            assert_eq!(list, expected);
        }
    }
}
