//! Groups of loops from the links of pairs: average linkage of the logits relative to the threshold.

/// Score of a pair that was not compared.
const APART: f64 = -8.0;
/// Largest score of a pair, either way.
const LIMIT: f64 = 8.0;

/// A pair of loops and the logit of its link minus the threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Link {
    pub pair: [usize; 2],
    pub score: f64,
}

/// Connected sets of two or more of `n` loops, each in rising order.
pub(super) fn connected(n: usize, pairs: impl Iterator<Item = [usize; 2]>) -> Vec<Vec<usize>> {
    // Union-find: each loop points to another loop of its set, or to itself.
    let mut towards: Vec<usize> = (0..n).collect();
    let first_of = |towards: &mut Vec<usize>, mut k: usize| {
        while towards[k] != k {
            towards[k] = towards[towards[k]];
            k = towards[k];
        }
        k
    };
    for [a, b] in pairs {
        let [a, b] = [a, b].map(|k| first_of(&mut towards, k));
        towards[a.max(b)] = a.min(b);
    }
    let mut sets = vec![Vec::new(); n];
    for member in 0..n {
        sets[first_of(&mut towards, member)].push(member);
    }
    sets.retain(|members| members.len() > 1);
    sets
}

/// Groups of two or more in a connected set, each in rising order. The closest two are merged while the mean score between them
/// is above 0.
pub(super) fn merged(part: &[usize], links: &[Link]) -> Vec<Vec<usize>> {
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
    clusters.iter_mut().for_each(|cluster| cluster.sort_unstable());
    clusters
}

#[cfg(test)]
mod tests {
    use super::*;

    fn links(scores: &[(usize, usize, f64)]) -> Vec<Link> {
        scores.iter().map(|(a, b, score)| Link { pair: [*a, *b], score: *score }).collect()
    }

    fn of(n: usize, links: &[Link]) -> Vec<Vec<usize>> {
        let sets = connected(n, links.iter().filter(|link| link.score > 0.0).map(|link| link.pair));
        sets.iter().flat_map(|set| merged(set, links)).collect()
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
