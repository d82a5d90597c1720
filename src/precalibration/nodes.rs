//! Values by node of a pattern.

/// Values for some of the nodes (i, j) of a range.
#[derive(Debug)]
pub(super) struct ByNode<T> {
    low: (i32, i32),
    size: (i32, i32),
    values: Vec<Option<T>>,
}

impl<T: Copy> ByNode<T> {
    /// Creates the map. If a node has several values, the last one counts.
    pub fn new(items: &[((i32, i32), T)]) -> Self {
        let nodes = || items.iter().map(|&(node, _)| node);
        let low = nodes().fold((i32::MAX, i32::MAX), |a, b| (a.0.min(b.0), a.1.min(b.1)));
        let high = nodes().fold((i32::MIN, i32::MIN), |a, b| (a.0.max(b.0), a.1.max(b.1)));
        let size = if items.is_empty() { (0, 0) } else { (high.0 - low.0 + 1, high.1 - low.1 + 1) };
        let count = |n: i32| usize::try_from(n).unwrap_or(0);
        let mut by_node = Self { low, size, values: vec![None; count(size.0) * count(size.1)] };
        for &(node, value) in items {
            if let Some(index) = by_node.index(node) {
                by_node.values[index] = Some(value);
            }
        }
        by_node
    }

    fn index(&self, (i, j): (i32, i32)) -> Option<usize> {
        let (x, y) = (i.wrapping_sub(self.low.0), j.wrapping_sub(self.low.1));
        let inside = (0..self.size.0).contains(&x) && (0..self.size.1).contains(&y);
        inside.then(|| usize::try_from(y * self.size.0 + x).ok()).flatten()
    }

    /// Returns the value of a node, if it has one.
    pub fn at(&self, node: (i32, i32)) -> Option<T> {
        self.values[self.index(node)?]
    }

    /// Returns the values of the nodes up to `reach` steps away along both axes, without the node itself.
    pub fn around(&self, node: (i32, i32), reach: i32) -> impl Iterator<Item = T> {
        (-reach..=reach)
            .flat_map(move |dj| (-reach..=reach).map(move |di| (di, dj)))
            .filter(|&step| step != (0, 0))
            .filter_map(move |(di, dj)| self.at((node.0 + di, node.1 + dj)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_are_those_that_have_a_value() {
        let items = [((-2, 5), 1), ((-1, 5), 2), ((0, 6), 3), ((5, 9), 4)];
        let by_node = ByNode::new(&items);
        let mut around: Vec<i32> = by_node.around((-1, 5), 1).collect();
        around.sort_unstable();
        assert_eq!(around, [1, 3]);
        assert_eq!(by_node.around((100, 100), 2).count(), 0);
        assert_eq!(ByNode::<i32>::new(&[]).around((0, 0), 3).count(), 0);
    }
}
