//! Groups of loops from the links of pairs: average linkage on the logits above the threshold.

/// Score of a pair that was not compared.
const APART: f64 = -8.0;
/// Largest score of a pair, either way.
const LIMIT: f64 = 8.0;

/// A pair of loops and the logit of its link less the threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Link {
    pub pair: [usize; 2],
    pub score: f64,
}

/// Groups of two and more of `n` loops, each in rising order, largest first. Two groups are merged, the closest first, while the
/// mean score between them is above 0.
pub(super) fn of(n: usize, links: &[Link]) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = connected(n, links).into_iter().flat_map(|part| merged(&part, links)).collect();
    groups.iter_mut().for_each(|group| group.sort_unstable());
    groups.sort_by_key(|group| (core::cmp::Reverse(group.len()), group[0]));
    groups
}

/// Sets of loops that scores above 0 connect.
fn connected(n: usize, links: &[Link]) -> Vec<Vec<usize>> {
    let mut set: Vec<usize> = (0..n).collect();
    for Link { pair: [a, b], .. } in links.iter().filter(|link| link.score > 0.0) {
        let (keep, give) = (set[*a], set[*b]);
        if keep != give {
            set.iter_mut().filter(|s| **s == give).for_each(|s| *s = keep);
        }
    }
    let mut sets = vec![Vec::new(); n];
    set.into_iter().enumerate().for_each(|(member, s)| sets[s].push(member));
    sets.retain(|members| members.len() > 1);
    sets
}

/// Average linkage among a connected set.
fn merged(part: &[usize], links: &[Link]) -> Vec<Vec<usize>> {
    let place = |loop_: usize| part.binary_search(&loop_).ok();
    // Sums of scores between clusters, which add up when clusters are merged.
    let mut sums = vec![vec![APART; part.len()]; part.len()];
    for link in links {
        if let [Some(a), Some(b)] = link.pair.map(place) {
            let score = link.score.clamp(-LIMIT, LIMIT);
            (sums[a][b], sums[b][a]) = (score, score);
        }
    }
    let mut clusters: Vec<Vec<usize>> = part.iter().map(|member| vec![*member]).collect();
    loop {
        let mut best: Option<(f64, usize, usize)> = None;
        for a in 0..clusters.len() {
            for b in a + 1..clusters.len() {
                let mean = sums[a][b] / (clusters[a].len() * clusters[b].len()) as f64;
                if mean > best.map_or(0.0, |found| found.0) {
                    best = Some((mean, a, b));
                }
            }
        }
        let Some((_, a, b)) = best else { break };
        let joining = clusters.swap_remove(b);
        clusters[a].extend(joining);
        let of_b = sums.swap_remove(b);
        for (c, row) in sums.iter_mut().enumerate() {
            let removed = row.swap_remove(b);
            if c != a {
                row[a] += removed;
            }
        }
        let mut of_b = of_b;
        of_b.swap_remove(b);
        for c in 0..clusters.len() {
            if c != a {
                sums[a][c] += of_b[c];
            }
        }
    }
    clusters.retain(|cluster| cluster.len() > 1);
    clusters
}

#[cfg(test)]
mod tests {
    use super::*;

    fn links(scores: &[(usize, usize, f64)]) -> Vec<Link> {
        scores.iter().map(|(a, b, score)| Link { pair: [*a, *b], score: *score }).collect()
    }

    #[test]
    fn loops_that_agree_are_joined_and_one_chance_link_does_not_chain_groups() {
        let found = of(
            6,
            &links(&[(0, 1, 5.0), (0, 2, 5.0), (1, 2, 4.0), (3, 4, 6.0), (2, 3, 0.5), (1, 3, -6.0), (0, 3, -6.0)]),
        );
        assert_eq!(found, [vec![0, 1, 2], vec![3, 4]]);
    }

    #[test]
    fn the_order_of_links_does_not_matter_and_nothing_is_lost() {
        let mut some = links(&[(0, 3, 2.0), (1, 3, 1.5), (0, 1, 0.5), (2, 4, 3.0), (5, 6, -1.0)]);
        let forward = of(7, &some);
        some.reverse();
        assert_eq!(forward, of(7, &some));
        assert_eq!(forward, [vec![0, 1, 3], vec![2, 4]]);
    }
}
