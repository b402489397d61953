// The imports of pictures, and the element in JSX.
/// <reference types="ssplat/client" />
/// <reference types="ssplat/react" />
