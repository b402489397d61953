//! SHA-256 (FIPS 180-4), which identifies the vectors' files; `spec/check.py` compares it with another implementation.

/// Returns the digest in hexadecimal.
pub fn sha256(data: &[u8]) -> String {
    let primes = || (2u64..).filter(|n| (2..).take_while(|d| d * d <= *n).all(|d| n % d != 0));
    // The first 32 bits after the binary point of a root of a prime.
    let fraction = |prime: u64, root: u32| {
        let (mut low, mut high) = (0u128, 1 << 40);
        while high - low > 1 {
            let middle = (low + high) / 2;
            let over = middle.pow(root) > u128::from(prime) << (32 * root);
            if over { high = middle } else { low = middle }
        }
        low as u32
    };
    let mut state: Vec<u32> = primes().take(8).map(|p| fraction(p, 2)).collect();
    let constants: Vec<u32> = primes().take(64).map(|p| fraction(p, 3)).collect();
    let mut padded = data.to_vec();
    padded.push(0x80);
    padded.resize((data.len() + 9).next_multiple_of(64) - 8, 0);
    padded.extend_from_slice(&(8 * data.len() as u64).to_be_bytes());
    for block in padded.chunks(64) {
        let mut w: Vec<u32> = block.chunks(4).map(|b| u32::from_be_bytes([b[0], b[1], b[2], b[3]])).collect();
        for i in 16..64 {
            let a = w[i - 15].rotate_right(7) ^ w[i - 15].rotate_right(18) ^ w[i - 15] >> 3;
            let b = w[i - 2].rotate_right(17) ^ w[i - 2].rotate_right(19) ^ w[i - 2] >> 10;
            w.push(w[i - 16].wrapping_add(a).wrapping_add(w[i - 7]).wrapping_add(b));
        }
        let mut s = state.clone();
        for i in 0..64 {
            let a = s[4].rotate_right(6) ^ s[4].rotate_right(11) ^ s[4].rotate_right(25);
            let choice = s[4] & s[5] ^ !s[4] & s[6];
            let t = s[7].wrapping_add(a).wrapping_add(choice).wrapping_add(constants[i]).wrapping_add(w[i]);
            let b = s[0].rotate_right(2) ^ s[0].rotate_right(13) ^ s[0].rotate_right(22);
            let majority = s[0] & s[1] ^ s[0] & s[2] ^ s[1] & s[2];
            s.rotate_right(1);
            s[4] = s[4].wrapping_add(t);
            s[0] = t.wrapping_add(b).wrapping_add(majority);
        }
        state.iter_mut().zip(s).for_each(|(a, b)| *a = a.wrapping_add(b));
    }
    state.iter().map(|word| format!("{word:08x}")).collect()
}
