//! Points that are as far from each other as can be (Gonzalez 1985): most ticks are alike, because an arm mostly stands
//! at its target, so that points at equal intervals, or at random, have little of what is rare.

/// Chooses up to `wanted` candidates one by one, each the farthest from those before it, and marks them by a negative
/// number in `least`. `looks` has `width` numbers for each candidate; `least` is infinite for what may be chosen, and 0
/// for what may not. The last of the candidates is the first choice. Returns how many were chosen.
pub fn spread_out(looks: &[f64], width: usize, least: &mut [f64], wanted: u64) -> u64 {
    let mut last = least.iter().rposition(|apart| *apart > 0.0);
    let mut chosen = 0;
    while let Some(at) = last.filter(|_| chosen < wanted) {
        least[at] = -1.0;
        chosen += 1;
        let mut farthest = 0.0;
        last = None;
        for k in 0..least.len() {
            if least[k] <= 0.0 {
                continue;
            }
            let (a, b) = (&looks[k * width..(k + 1) * width], &looks[at * width..(at + 1) * width]);
            let apart = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum();
            least[k] = least[k].min(apart);
            if least[k] > farthest {
                farthest = least[k];
                last = Some(k);
            }
        }
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_choice_is_the_farthest_from_those_before() {
        let looks = [0.0, 0.1, 5.0, 9.0, 10.0];
        let mut least = [f64::INFINITY; 5];
        least[3] = 0.0;
        assert_eq!(spread_out(&looks, 1, &mut least, 3), 3);
        let chosen: Vec<usize> = (0..5).filter(|k| least[*k] < 0.0).collect();
        assert_eq!(chosen, [0, 2, 4]);
        // What is equal to a choice is none.
        assert_eq!(spread_out(&[1.0, 1.0], 1, &mut [f64::INFINITY; 2], 2), 1);
    }
}
