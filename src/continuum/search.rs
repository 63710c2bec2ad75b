//! Places in short sorted lists.

/// Counting all of so few takes less time than a search, whose every step waits for the one before.
const FEW: usize = 16;

/// How many items `is_leading` holds for: it holds for the first ones, and for none that follow.
pub fn count_leading<T>(items: &[T], is_leading: impl Fn(&T) -> bool) -> usize {
    if items.len() <= FEW {
        items.iter().map(|item| usize::from(is_leading(item))).sum()
    } else {
        items.partition_point(is_leading)
    }
}

#[cfg(test)]
mod tests {
    use super::count_leading;

    #[test]
    fn few_and_many_are_counted_alike() {
        for n in [0, 1, 15, 16, 17, 40] {
            let items: Vec<_> = (0..n).collect();
            for limit in 0..=n {
                assert_eq!(count_leading(&items, |item| *item < limit), limit);
            }
        }
    }
}
